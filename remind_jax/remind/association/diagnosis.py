"""How clear is the evidence for each detection? (paper III-E).

Rules: method.md#reliable-anchors, method.md#status.
"""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Status
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import rank_two
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import divide
from remind_jax.remind.thresholds.association import Diagnosis

NUM_CHANNELS = 4  # the original counts object, background, ring prototypes and parts
_EPS = 1e-6
_TINY = 1e-12


@pytree
class Evidence:
    """Diagnosis of every detection over a set of its candidates."""

    status: Int[Array, "N"]  # decision.Status
    best_score: Float[Array, "N"]  # 0 without candidates
    second_score: Float[Array, "N"]  # 0 without a second one
    num_close: Int[Array, "N"]  # candidates within `close` of the best, itself included
    confidence: Float[Array, "N"]  # [0, 1]


def find_anchors(
    scores: Float[Array, "N O"], candidate: Bool[Array, "N O"], t: Diagnosis
) -> Bool[Array, "N O"]:
    """Pairs so clear that they may speak for their surroundings (method.md#reliable-anchors).

    At most one detection per object: the better one, the first among equals.
    """
    best, top, second, number = rank_two(scores, candidate)
    clear = (number > 0) & (top >= t.anchor_score) & (top - second >= t.anchor_margin)
    return grant_claims(clear, best, top, scores.shape[1])


def grant_claims(
    claims: Bool[Array, "N"], column: Int[Array, "N"], score: Float[Array, "N"], num_columns: int
) -> Bool[Array, "N O"]:
    """Pairs of the rows that claim a column; of several that claim the same, the best stands."""
    claimed = claims[:, None] & (jnp.arange(num_columns) == column[:, None])
    winner = jnp.argmax(jnp.where(claimed, score[:, None], -jnp.inf), axis=0)
    return claimed & (jnp.arange(len(claims))[:, None] == winner[None])


def admit_by_status(
    status: Int[Array, "N"],
    strong: Bool[Array, ""],
    ambiguous: Bool[Array, ""],
    weak: Bool[Array, ""],
) -> Bool[Array, "N"]:
    """Detections whose status is admitted; one without a status always is."""
    shut = (status == Status.STRONG) & ~strong
    shut = shut | ((status == Status.AMBIGUOUS) & ~ambiguous)
    return ~(shut | ((status == Status.WEAK) & ~weak))


def diagnose(
    scores: Float[Array, "N O"],
    counted: Bool[Array, "N O"],
    num_terms: Int[Array, "N"],
    margin: Literal["sigmoid", "linear", "linear_relative", "sigmoid_relative"],
    t: Diagnosis,
) -> Evidence:
    """Tells STRONG, AMBIGUOUS and WEAK detections apart and rates the evidence."""
    _, top, second, count = rank_two(scores, counted)
    some, gap = count > 0, top - second
    near = counted & (scores >= (top - jnp.maximum(0.0, t.close))[:, None])
    num_near, total = reduce_together(
        ("sum", near), ("sum", jnp.where(counted, scores, 0.0)), axis=1
    )
    num_close = jnp.where(some, jnp.maximum(1, num_near), 0)
    clear = (top >= t.strong_score) & (gap >= t.strong_gap) & (num_close <= 1)
    status = jnp.where(top >= t.ambiguous_score, Status.AMBIGUOUS, Status.WEAK)
    status = jnp.where(clear, Status.STRONG, status)
    status = jnp.where(some, status, Status.WEAK)

    rest = total - top
    others = jnp.where(count > 1, rest / jnp.maximum(1, count - 1), 0.0)
    small = jnp.maximum(t.small, _TINY)
    distinct = jnp.maximum(0.0, top - others) / jnp.maximum(1.0 - others, small)
    temperature = jnp.where(t.temperature > small, t.temperature, t.temperature_least)
    lead = 1.0 / (1.0 + jnp.exp(divide(second - top, jnp.maximum(temperature, _TINY))))
    covered = num_terms.astype(top.dtype) / NUM_CHANNELS
    covered = jnp.minimum(1.0, divide(covered, jnp.maximum(_EPS, t.coverage_target)))
    value = top * lead * _margin(gap, top, margin, t) * jnp.clip(covered, 0.0, 1.0)
    value = jnp.clip(value * jnp.clip(distinct, 0.0, 1.0), 0.0, 1.0)
    return Evidence(
        status=jnp.where(t.enabled, status, Status.NONE),
        best_score=top,
        second_score=second,
        num_close=num_close,
        confidence=jnp.where(some & t.confidence_enabled, value, 0.0),
    )


def _margin(gap: Array, top: Array, kind: str, t: Diagnosis) -> Float[Array, "N"]:
    """How far the best candidate leads, [0, 1] (method.md#confidence)."""
    small = jnp.maximum(t.small, _TINY)
    relative = jnp.where(top > 0, gap / jnp.maximum(top, small), 0.0)
    value = relative if kind.endswith("relative") else jnp.maximum(0.0, gap)
    if kind.startswith("linear"):
        return jnp.clip(value, 0.0, 1.0)
    scale = jnp.where(t.gap_scale <= small, t.gap_scale_least, t.gap_scale)
    slope = divide(value - t.gap_center, jnp.maximum(scale, _TINY))
    return 1.0 / (1.0 + jnp.exp(-jnp.clip(slope, -50.0, 50.0)))
