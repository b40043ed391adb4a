"""Which pairs may be assigned, and with what score? (paper III-E; association notes 11)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from remind_jax.config.thresholds import Matching


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Pairs:
    """Score table of the frame; rows are detections, columns objects."""

    eligible: Bool[Array, "N O"]  # open to assignment
    score_assign: Float[Array, "N O"]  # what the assignment maximises
    score_final: Float[Array, "N O"]  # what is tested for acceptance and reported


def initial_pairs(score: Float[Array, "N O"]) -> Pairs:
    """The table before any gate: all scores visual, nothing eligible."""
    return Pairs(jnp.zeros(score.shape, bool), score, score)


def gate_pairs(
    pairs: Pairs,
    candidate: Bool[Array, "N O"],
    score: Float[Array, "N O"],
    rows: Bool[Array, "N"],
    used: Bool[Array, "O"],
    t: Matching,
) -> Pairs:
    """Opens the pairs that are good enough and rewrites the scores of those.

    Args:
      pairs: Table to update; rows outside `rows` and scores of closed pairs stay.
      candidate: Pairs of one class.
      score: Visual score.
      rows: Detections still to be assigned.
      used: Objects already taken.
      t: Thresholds.
    """
    good = candidate & ((score >= t.min_visual) | ~t.gate_min_visual)
    good = good & ((score >= t.match) | ~t.gate_match)
    opened = good & ~used[None] & rows[:, None]
    return Pairs(
        eligible=jnp.where(rows[:, None], opened, pairs.eligible),
        score_assign=jnp.where(opened, score, pairs.score_assign),
        score_final=jnp.where(opened, score, pairs.score_final),
    )
