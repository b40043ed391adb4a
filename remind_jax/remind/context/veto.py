"""Which pairs does the context rule out? (paper III-D).

Rules: method.md#expected-neighbors, method.md#plausible-elsewhere, method.md#veto.
"""

from __future__ import annotations

import enum

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.ranks import pick_best
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import divide
from remind_jax.remind.context.evidence import FrameView
from remind_jax.remind.context.influence import Influence
from remind_jax.remind.memory.cooccurrence import rank_neighbors, ranked_neighbors
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.context import Veto as Rules
from remind_jax.static import Static

_TOP = 3  # best candidates of a detection that count as plausibly in view
_MATURITY_RATE, _LEAST_MATURITY = 0.25, 0.5  # of an object whose own neighbors may speak


class Veto(enum.IntEnum):
    """Why a pair is ruled out."""

    NONE = 0
    OUTSIDE_CTX = 1  # outside the few objects of its class that the context supports
    LOCAL_CTX_CONTRADICTION = 2  # none of the neighbors that the object leads one to expect


def veto_pairs(
    influence: Influence,
    view: FrameView,
    candidate: Bool[Array, "N O"],
    score: Float[Array, "N O"],
    static: Static,
    thresholds: Thresholds,
) -> Int[Array, "N O"]:
    """Rules pairs out, by code of `Veto`."""
    t, matching = thresholds.veto, thresholds.matching
    open_to = t.enabled & influence.enabled & influence.has_pack
    open_to = open_to & ~(influence.soft_supported | influence.shortlist | influence.compat_band)
    expected = expect_neighbors(view, thresholds.sets.min_link, static, t)
    visual_gate = jnp.maximum(matching.match, matching.min_visual)
    seen = plausibly_in_view(candidate, score, visual_gate)
    local = _contradicts_neighbors(influence.quality, expected, seen, view.graph.episodes, t)
    outside = (influence.compat_rel <= t.max_support) & (influence.score_sets <= t.max_score)
    outside = outside & influence.global_ok & (influence.quality >= t.min_quality)
    outside = outside & (influence.kept_count > 0) & (influence.kept_count <= t.max_supported)
    outside = outside & (influence.pruning >= t.min_pruning)
    outside = outside & (influence.strength >= t.min_strength)
    reason = jnp.where(outside[None], Veto.OUTSIDE_CTX, Veto.NONE)
    reason = jnp.where(local, Veto.LOCAL_CTX_CONTRADICTION, reason)
    return jnp.where(candidate & open_to[None], reason, Veto.NONE).astype(jnp.int32)


def expect_neighbors(
    view: FrameView, min_link: Float[Array, ""], static: Static, t: Rules
) -> Bool[Array, "O O"]:
    """Neighbors that one expects to see with each row object (method.md#expected-neighbors).

    The closest and latest first, of conditional probability `min_link` at least, until the list is
    full, or long enough and likely to contain something that is in view.
    """
    graph = view.graph
    slots = graph.episodes.shape[0]
    length = min(static.switches.max_neighbours or slots, slots)
    order, known = ranked_neighbors(rank_neighbors(graph, "weight"), length)
    link = jnp.take_along_axis(view.conditional, order, axis=1)
    taken = known & (link >= min_link)
    place = np.arange(length)
    upto = taken[:, None] & (place <= place[:, None])
    number, mass = reduce_together(
        ("sum", upto), ("sum", jnp.where(upto, link[:, None], 0.0)), axis=2
    )
    enough = (number >= max(1, static.switches.context_hypotheses)) & (mass >= t.local_mass)
    ends = taken & (enough | (number >= static.switches.expected_neighbours))
    ended_before = jnp.any(ends[:, None] & (place < place[:, None]), axis=2)
    kept = taken & ~ended_before
    return jnp.any((order[..., None] == jnp.arange(slots)) & kept[..., None], axis=1)


def plausibly_in_view(
    candidate: Bool[Array, "N O"], score: Float[Array, "N O"], visual_gate: Float[Array, ""]
) -> Bool[Array, "N O"]:
    """Best candidates of all other detections of the frame (method.md#plausible-elsewhere).

    Looks alone count, late objects win ties.
    """
    best, _ = pick_best(score, candidate & (score >= visual_gate), _TOP, later_first=True)
    named = jnp.any(best[..., None] == jnp.arange(score.shape[1]), axis=1)
    times = jnp.sum(named, axis=0, dtype=jnp.int32)
    return times[None] > named


def _contradicts_neighbors(
    quality: Float[Array, ""],
    expected: Bool[Array, "O O"],
    seen: Bool[Array, "N O"],
    episodes: Int[Array, "O"],
    t: Rules,
) -> Bool[Array, "N O"]:
    """Pairs whose object expects neighbors of which (nearly) none is in view."""
    scalar = quality.dtype
    num_expected = jnp.sum(expected, axis=1, dtype=jnp.int32)
    num_seen = jnp.sum(seen, axis=1, dtype=jnp.int32)
    # Counts are small whole numbers: exact whatever the precision of the product.
    common = jnp.matmul(seen.astype(jnp.float32), expected.T.astype(jnp.float32))
    share = divide(common.astype(scalar), jnp.maximum(num_expected, 1).astype(scalar))
    mature = 1.0 - jnp.exp(-_MATURITY_RATE * episodes.astype(scalar)) >= _LEAST_MATURITY
    informative = (
        (episodes >= t.local_min_episodes) & (num_expected >= t.local_min_expected) & mature
    )
    applies = t.local & (quality >= t.local_min_quality) & (num_seen >= t.local_min_seen)
    return applies[:, None] & informative[None] & (share < t.local_max_hit_share)
