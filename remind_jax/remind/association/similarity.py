"""How similar is each detection to each object? (paper III-E).

Rules: method.md#channel-scores, method.md#visual-score.

Scores of channels are collapsed to four terms, and the terms averaged by weights that carry the
quality of the observation. An absent value is not zero: presence travels beside every score.
Letters: `N` detections, `O` objects, `A C R` channels, `T` terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from remind_jax.numerics.columns import columns
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.rounding import divide
from remind_jax.observation import Descriptors
from remind_jax.remind.association.channel_scores import ChannelScores, Score, compare_channels
from remind_jax.remind.association.quality import Quality
from remind_jax.remind.state import TrackerState
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.association import Similarity
from remind_jax.static import Static

OBJECT, BACKGROUND, PARTS = 0, 1, 2
RING_PROTOTYPES = 3  # only with `static.ring_prototypes`
_SUMMED = (OBJECT, BACKGROUND, RING_PROTOTYPES, PARTS)  # in this order, as in the original
_NO_WEIGHT = 1e-12  # at most
Rule = Literal["work", "stable", "prefer_stable", "max"]


@pytree
class Terms:
    """The scores of each pair by term, and how proven the object evidence is."""

    value: Float[Array, "*V T N O"]
    present: Bool[Array, "*V T N O"]
    authority: Float[Array, "*V N O"]  # 1 where absent


AUTO, WORK, STABLE, _NEUTRAL = 0, 1, 2, 3
# Which bank counts: the rule of each term, for each of these ways to compare.
_WAYS: tuple[tuple[Rule, ...], ...] = (
    ("prefer_stable", "prefer_stable", "max", "max"),
    ("work", "work", "work", "work"),
    ("stable", "stable", "stable", "stable"),
    ("max", "max", "max", "max"),
)


@pytree
class Comparison:
    """Visual evidence between detections and objects."""

    candidate: Bool[Array, "N O"]  # same class; nothing else rules an object out
    score: Float[Array, "N O"]  # the visual score, [0, 1]; 0 for non-candidates
    terms: Terms  # by AUTO, WORK or STABLE, as fits all candidates of the detection
    auto: Terms  # under AUTO
    neutral: Terms  # the better of both banks, for scores comparable between candidates
    neutral_weights: Float[Array, "T N 1"]  # without the authority of the prototypes
    pending_score: Float[Array, "N P"]  # visual score with undecided tracks, under AUTO


def compare(
    state: TrackerState,
    descriptors: Descriptors,
    quality: Quality,
    static: Static,
    thresholds: Thresholds,
) -> Comparison:
    """Scores every detection against objects and undecided tracks (method.md#candidates)."""
    objects, t = state.objects, thresholds.similarity
    slots = objects.id.shape[0]
    candidate = descriptors.valid[:, None] & objects.exists[None]
    candidate = candidate & (descriptors.class_id[:, None] == objects.class_id[None])
    channels = compare_channels(state, descriptors, static, thresholds)

    ways = collapse(channels, static, t)
    width = ways.authority.shape[-1]
    of_objects = jax.tree.map(lambda leaf: leaf[..., :slots], ways)
    # One bank for all candidates of a detection where all have it, stable first
    # (method.md#bank-source).
    everywhere = jnp.all(of_objects.present[: STABLE + 1] | ~candidate, axis=-1)
    source = jnp.where(everywhere[STABLE], STABLE, jnp.where(everywhere[WORK], WORK, AUTO))
    taken = jnp.where(jnp.arange(width) < slots, source[..., None], AUTO)
    value, present = (_choose_way(leaf, taken) for leaf in (ways.value, ways.present))
    terms = Terms(value, present, _choose_way(ways.authority, taken[OBJECT]))
    num_terms = len(terms.value)
    weights = term_weights(quality, terms.authority, t, num_terms)
    counted = jnp.pad(candidate, ((0, 0), (0, width - slots)), constant_values=True)
    score = weighted_mean(terms.value, terms.present & counted, weights, t)
    return Comparison(
        candidate=candidate,
        score=score[:, :slots],
        terms=jax.tree.map(lambda leaf: leaf[..., :slots], terms),
        auto=jax.tree.map(lambda leaf: leaf[AUTO], of_objects),
        neutral=jax.tree.map(lambda leaf: leaf[_NEUTRAL], of_objects),
        neutral_weights=term_weights(quality, None, t, num_terms),
        pending_score=score[:, slots:],
    )


def _choose_way(values: Shaped[Array, "V *B"], taken: Int[Array, "*B"]) -> Shaped[Array, "*B"]:
    """The value of AUTO, WORK or STABLE, whichever is taken."""
    forced = jnp.where(taken == STABLE, values[STABLE], values[WORK])
    return jnp.where(taken == AUTO, values[AUTO], forced)


def comparable_score(
    comparison: Comparison, members: Bool[Array, "N O"], t: Similarity
) -> Float[Array, "N O"]:
    """Score on the evidence that all members of a set have (method.md#comparable-score)."""
    neutral = comparison.neutral
    common = jnp.all(neutral.present | ~members, axis=-1, keepdims=True)
    score = weighted_mean(neutral.value, neutral.present & common, comparison.neutral_weights, t)
    return jnp.where(jnp.any(common, axis=0), score, comparison.score)


def count_terms(comparison: Comparison) -> Int[Array, "N"]:
    """Terms that are present between each detection and its best candidate, under "auto"."""
    best = jnp.argmax(jnp.where(comparison.candidate, comparison.score, -jnp.inf), axis=1)
    is_best = best[:, None] == jnp.arange(comparison.candidate.shape[1])
    present = comparison.auto.present & comparison.candidate & is_best
    return jnp.sum(present, axis=(0, 2), dtype=jnp.int32)


def collapse(c: ChannelScores, static: Static, t: Similarity) -> Terms:
    """Reduces the banks, then the channels, to terms, in all ways (method.md#visual-score)."""
    of_term = list(zip(*_WAYS, strict=True))
    score, takes_stable = _collapse_banks(c.objects, of_term[OBJECT])
    authority = jnp.where(takes_stable, c.authority[1], c.authority[0])
    best = [
        (Score(score.value[:, channel], score.present[:, channel]), authority[:, channel])
        for channel, name in enumerate(("global", "trimmed"))
        if static.switches.object_channel in ("best", name)
    ]
    (obj, authority), *others = best
    for other, its_authority in others:  # the first among equals
        wins = other.present & (~obj.present | (other.value > obj.value))
        obj = jax.tree.map(lambda new, old, wins=wins: jnp.where(wins, new, old), other, obj)
        authority = jnp.where(wins, its_authority, authority)
    authority = jnp.where(obj.present, authority, 1.0)

    back, _ = _collapse_banks(_combine_rings(c.rings, static, t), of_term[BACKGROUND])
    parts, _ = _collapse_banks(c.parts, of_term[PARTS])
    counted = jnp.array(
        [static.switches.part_channel in ("best", c) for c in static.switches.part_channels]
    )
    present = parts.present & counted[:, None, None]
    parts = Score(jnp.max(jnp.where(present, parts.value, 0.0), axis=1), jnp.any(present, axis=1))
    terms = [obj, back, parts]
    if c.prototypes is not None:
        terms.append(_collapse_banks(_join_rings(c.prototypes, t), of_term[RING_PROTOTYPES])[0])
    return Terms(
        value=jnp.stack([term.value for term in terms], axis=1),
        present=jnp.stack([term.present for term in terms], axis=1),
        authority=authority,
    )


def _collapse_banks(banks: Score, rules: Sequence[Rule]) -> tuple[Score, Bool[Array, "..."]]:
    """One score from the two banks for each rule, and whether it is the stable one."""
    work, stable = (Score(banks.value[bank], banks.present[bank]) for bank in range(2))
    is_rule = {
        rule: np.array([one == rule for one in rules]).reshape(-1, *[1] * work.present.ndim)
        for rule in ("stable", "prefer_stable", "max")
    }
    is_better = ~work.present | (stable.value >= work.value)
    asks = is_rule["prefer_stable"] | (is_rule["max"] & is_better[None])
    takes_stable = jnp.logical_or(is_rule["stable"], stable.present[None] & asks)
    score = jax.tree.map(
        lambda new, old: jnp.where(takes_stable, new[None], old[None]), stable, work
    )
    return score, takes_stable


def _combine_rings(rings: Score, static: Static, t: Similarity) -> Score:
    """Joins inner and outer ring; one alone counts in full (method.md#channel-scores)."""
    if static.switches.ring_channel == "inner":
        return jax.tree.map(lambda leaf: leaf[:, 0], rings)
    if static.switches.ring_channel == "outer":
        return jax.tree.map(lambda leaf: leaf[:, 1], rings)
    return _join_rings(rings, t)


def _join_rings(rings: Score, t: Similarity) -> Score:
    given = [jnp.maximum(share, 0.0) for share in (t.inner_share, t.outer_share)]
    total = given[0] + given[1]
    shares = divide(columns(*given), jnp.maximum(total, 1e-12))
    shares = jnp.where(total > 1e-12, shares, 0.5)
    inner, outer = rings.value[:, 0], rings.value[:, 1]
    has_inner, has_outer = rings.present[:, 0], rings.present[:, 1]
    joint = divide(shares[0] * inner + shares[1] * outer, shares[0] + shares[1])
    return Score(jnp.where(has_inner & has_outer, joint, inner + outer), has_inner | has_outer)


def term_weights(
    quality: Quality,
    authority: Float[Array, "N O"] | None,
    t: Similarity,
    num_terms: int,
) -> Float[Array, "T N #O"]:
    """Weights of the terms after the quality of observation and prototype (method.md#term-weights).

    Without authority the prototypes are not asked (method.md#comparable-score).
    """
    lift = lambda q, floor: floor + (1.0 - floor) * jnp.clip(q, 0.0, 1.0)  # noqa: E731
    seen = quality.object[:, None]
    if authority is not None:
        seen = jnp.sqrt(jnp.maximum(0.0, seen * authority))
    ones = jnp.ones_like(seen)
    obj = lift(seen, t.object_floor) * quality.object_density[:, None]
    back = lift(quality.background, t.background_floor)[:, None] * ones
    parts = (lift(quality.parts, t.parts_floor) * quality.parts_density)[:, None] * ones
    weights = [t.object_weight * obj, t.background_weight * back, t.parts_weight * parts]
    return jnp.stack([*weights, t.ring_prototypes_weight * back][:num_terms])


def weighted_mean(
    value: Float[Array, "T N O"],
    present: Bool[Array, "T N O"],
    weights: Float[Array, "T N #O"],
    t: Similarity,
) -> Float[Array, "N O"]:
    """One score of the terms that count (method.md#visual-score, method.md#first-view)."""
    nominal = (t.object_weight, t.background_weight, t.parts_weight, t.ring_prototypes_weight)
    terms = range(len(value))
    # Term by term, so that nothing but the mean is written down.
    counted = [present[term] & (nominal[term] > 0) for term in terms]
    own = [jnp.where(counted[term], weights[term], 0.0) for term in terms]
    silent = t.nominal_if_silent & (sum(own) <= _NO_WEIGHT)
    total, weight = jnp.zeros(value.shape[1:], value.dtype), jnp.zeros(value.shape[1:], value.dtype)
    for term in [term for term in _SUMMED if term < len(value)]:
        share = jnp.where(silent & counted[term], nominal[term], own[term])
        total = total + share * jnp.where(counted[term], value[term], 0.0)
        weight = weight + share
    mean = jnp.where(weight > _NO_WEIGHT, total / jnp.maximum(weight, _NO_WEIGHT), 0.0)
    return jnp.where(t.renormalize, mean, total)
