"""What the others in view say: how they lie, and who is usually seen with whom.

Rules: method_plus.md#layout-evidence, method_plus.md#company-evidence,
method_plus.md#joint-weighing.

All open tracklets of a frame are weighed together by mean field: what one of them may be depends on
what the others may be.

Letters: `N` detections, `C` candidates, `O` object slots. Evidence is in log odds.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.plus import thresholds as th
from remind_jax.plus.evidence import Shortlist, mix, relation_error
from remind_jax.plus.observation import Sightings
from remind_jax.plus.state import NO_RELATION, NUM_OWN_PARTS, PARTS, Objects, Pairs
from remind_jax.plus.vacancy import find_gone


def weigh_jointly(
    shortlist: Shortlist,
    anchor: Int[Array, "N"],
    is_anchor: Bool[Array, "N"],
    sightings: Sightings,
    objects: Objects,
    pairs: Pairs,
    t: th.PlusThresholds,
) -> tuple[Float[Array, "N C"], Float[Array, "N C"], Float[Array, "N C 8"]]:
    """Evidence of each candidate with that of all others in view.

    Args:
      shortlist: Candidates of the rows.
      anchor: Object of each detection that is decided.
      is_anchor: Detections that speak for their surroundings with full weight.
      sightings: Detections.
      objects: Objects.
      pairs: What is known of every two of them.
      t: Weights.

    Returns:
      Log odds of each candidate, its probability beside all others and a new object, and what each
      of `PARTS` has in the log odds.
    """
    num, width = shortlist.slot.shape
    # A party is what a detection may be: its candidates, or the one object of an anchor.
    first = jnp.arange(width) == 0
    party = jnp.where(is_anchor[:, None], anchor[:, None], shortlist.slot)
    present = jnp.where(is_anchor[:, None], first, shortlist.valid)

    o, p = shortlist.slot.reshape(-1)[:, None], party.reshape(-1)[None, :]
    row = jnp.repeat(jnp.arange(num), width)
    usable = shortlist.valid.reshape(-1)[:, None] & present.reshape(-1)[None, :]
    usable &= (row[:, None] != row[None, :]) & (o != p)
    geometry = _Geometry(sightings, row)
    covisible = jnp.where(usable, _covisible_evidence(o, p, geometry, objects, pairs, t.layout), 0)
    related = usable & (pairs.spread[o, p] < NO_RELATION)
    layout = jnp.where(related, _layout_evidence(o, p, geometry, pairs, t.layout), 0)

    base, place = shortlist.base, shortlist.parts[..., PARTS.index("place")]
    # What looks wrong is no witness for the others: where a new arrangement lies like an old one,
    # its members would otherwise talk each other into being known.
    looks = shortlist.parts[..., PARTS.index("looks")]
    credible = jax.nn.sigmoid(t.layout.witness_slope * (looks + t.layout.witness))
    is_gone = find_gone(anchor, is_anchor, sightings, pairs, t.layout)[shortlist.slot]
    moved = jnp.where(is_gone, t.layout.moved_gone, t.layout.moved)

    def ask(weight: Float[Array, "N C"]) -> Float[Array, "3 N C"]:
        w = weight.reshape(-1)
        lies = t.layout.weight * _pooled(layout, related, w, t.layout.partners, t.layout.best)
        companions = t.layout.covisible_weight * _pooled(
            covisible, usable, w, t.layout.covisible_partners, jnp.inf
        )
        lies, companions = lies.reshape(num, width), companions.reshape(num, width)
        # Whatever lies wrong may have been moved: looks can still show it.
        given_back = jnp.maximum(moved - (place + lies), 0.0)
        return jnp.stack([lies, companions, given_back])

    def total(around: Float[Array, "3 N C"]) -> Float[Array, "N C"]:
        return base + jnp.sum(around, axis=0)

    def believe(odds: Float[Array, "N C"], handicap: Array | float) -> Float[Array, "N C"]:
        new = jnp.broadcast_to(t.decision.new - handicap, (num, 1))
        all_odds = jnp.concatenate([jnp.where(shortlist.valid, odds, -jnp.inf), new], axis=1)
        return jax.nn.softmax(all_odds, axis=1)[:, :width]

    def reconsider(k: Array, around: Float[Array, "3 N C"]) -> Float[Array, "3 N C"]:
        handicap = t.layout.optimism * (1.0 - k / t.layout.rounds)
        belief = credible * believe(total(around), handicap)
        weight = jnp.where(is_anchor[:, None], 1.0 * first, belief)
        return ask(jnp.where(present, weight, 0.0))

    nothing = jnp.zeros((len(PARTS) - NUM_OWN_PARTS, num, width), base.dtype)
    around = jax.lax.fori_loop(0, t.layout.rounds, reconsider, nothing)
    odds = total(around)
    parts = jnp.concatenate([shortlist.parts, jnp.moveaxis(around, 0, -1)], axis=-1)
    return jnp.where(shortlist.valid, odds, -jnp.inf), believe(odds, 0.0), parts


class _Geometry:
    """Pairwise geometry of detections, spread to hypotheses and parties."""

    def __init__(self, sightings: Sightings, row: Int[Array, "M"]) -> None:
        center, size, touches = sightings.center, sightings.size, sightings.touches

        def spread(values: Array) -> Array:
            return values[row[:, None], row[None, :]]

        offset = center[None, :] - center[:, None]
        self.scale = spread(jnp.sqrt(size[:, None] * size[None, :]))
        self.offset = offset[row[:, None], row[None, :]]
        self.log_ratio = spread(jnp.log(size[:, None] / size[None, :]))
        self.border = spread(touches[:, None] | touches[None, :])
        self.squared = spread(jnp.sum(offset**2, axis=-1))


def _layout_evidence(
    o: Int[Array, "M 1"], p: Int[Array, "1 M"], geometry: _Geometry, pairs: Pairs, t: th.Layout
) -> Float[Array, "M M"]:
    """Does the one lie from the other as these objects do? In sizes, so from afar as well."""
    relation, border = pairs.relation[o, p], geometry.border
    error = relation_error(relation, pairs.spread[o, p], border, t)
    off = geometry.offset / geometry.scale[..., None] - relation
    squared = jnp.sum(off**2, axis=-1) * geometry.scale**2
    variance = (error * geometry.scale) ** 2
    odds = mix(squared, variance, t.lost, t.least_doubt, jnp.float32(0), th.FRAME_AREA)
    odds = jnp.clip(odds, -t.pair_best, t.pair_best)

    ratio_error = jnp.where(border, t.ratio_error_border, t.ratio_error)
    off_ratio = (geometry.log_ratio - pairs.log_ratio[o, p]) ** 2
    ratio_odds = -jnp.log(ratio_error) - off_ratio / (2 * ratio_error**2) + off_ratio / 2
    return odds + t.ratio_weight * jnp.clip(ratio_odds, -2.0, 1.0)


def _covisible_evidence(
    o: Int[Array, "M 1"],
    p: Int[Array, "1 M"],
    geometry: _Geometry,
    objects: Objects,
    pairs: Pairs,
    t: th.Layout,
) -> Float[Array, "M M"]:
    """Are these objects seen together more often than by chance?"""
    together = pairs.covisible[o, p] + 0.5
    frames = jnp.minimum(objects.seen[o], objects.seen[p]) + 3.0
    odds = jnp.log(together / frames / t.covisible_typical)
    odds = jnp.clip(odds, -t.covisible_best, t.covisible_best)
    # The absence of a companion means little far away from it.
    nearness = jnp.exp(-geometry.squared / (2 * t.near**2))
    return jnp.where(odds < 0, odds * nearness, odds)


def _pooled(
    evidence: Float[Array, "M M"],
    usable: Bool[Array, "M M"],
    weight: Float[Array, "M"],
    partners: Float[Array, ""],
    limit: Float[Array, ""] | float,
) -> Float[Array, "M"]:
    """Sum over parties; more than so many partners share what so many may say."""
    total = usable.astype(jnp.float32) @ weight
    pooled = jnp.matmul(evidence, weight, precision="highest")
    return jnp.clip(pooled * jnp.minimum(1.0, partners / jnp.maximum(total, 1e-6)), -limit, limit)
