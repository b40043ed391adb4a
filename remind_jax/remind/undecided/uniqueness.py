"""One identity, one detection: an object that two detections claim stays with the better one.

The published tracker lets layout give a detection an object that another one holds already
(method.md#one-detection-each). Nothing can be in two places, and scorers refuse such output.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Reason
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.undecided.temporal import PairTable, rank, temporal_score


def withdraw_second_claims(
    table: PairTable,
    slot: Int[Array, "N"],
    score: Float[Array, "N"],
    enabled: Bool[Array, ""],
    most: Int[Array, ""],
) -> Undecided:
    """Finds detections whose object another detection holds with a better score.

    They become ambiguous between that object and their other plausible candidates. Among equals
    the first detection keeps the object.

    Args:
      table: Scores and gates of all pairs.
      slot: Matched object of each detection, -1 none.
      score: Of the match.
      enabled: Whether anything is withdrawn.
      most: Largest number of candidates named.
    """
    num, width = table.plausible.shape
    first = jnp.arange(num)
    rival = (slot[:, None] == slot[None]) & (slot >= 0)[:, None]
    better = score[None] > score[:, None]
    better = better | ((score[None] == score[:, None]) & (first[None] < first[:, None]))
    loses = jnp.any(rival & better, axis=1) & enabled

    claimed = slot[:, None] == jnp.arange(width)
    others = table.plausible & ~claimed
    slots, scores = rank(temporal_score(table, others), others, most - 1)
    return Undecided(
        present=loses,
        slot=jnp.concatenate([slot[:, None], slots[:, :-1]], axis=1),
        score=jnp.concatenate([score[:, None], scores[:, :-1]], axis=1),
        best=jnp.where(slot == NO_SLOT, 0.0, jnp.maximum(score, scores[:, 0])),
        reason=jnp.full(num, Reason.KNOWN_BUT_HELD_BY_BETTER_MATCH, jnp.int32),
    )
