"""What the others in view say: how they lie, and who is usually seen with whom.

Rules: method_plus.md#layout-evidence, method_plus.md#company-evidence,
method_plus.md#joint-weighing.

All open tracklets of a frame are weighed together by mean field: what one of them may be depends on
what the others may be.

Letters: `N` detections, `C` candidates, `O` object slots, `W` detections that one asks. Evidence is
in log odds.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from remind_jax.plus import thresholds as th
from remind_jax.plus.evidence import Evidence, OwnEvidence, Shortlist, mix, relation_error
from remind_jax.plus.observation import Sightings
from remind_jax.plus.plane import squared_length
from remind_jax.plus.slots import look_up
from remind_jax.plus.state import NO_RELATION, Objects, Pairs
from remind_jax.plus.static import NUM_CANDIDATES, NUM_WITNESSES
from remind_jax.plus.vacancy import find_gone


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Weighed:
    """What is held of each candidate in the end; 0 for what is no candidate."""

    odds: Float[Array, "N C"]  # log odds
    belief: Float[Array, "N C"]  # probability beside all others and a new object
    evidence: Evidence  # what is in the log odds


def weigh_jointly(
    shortlist: Shortlist,
    anchor: Int[Array, "N"],
    is_anchor: Bool[Array, "N"],
    sightings: Sightings,
    objects: Objects,
    pairs: Pairs,
    frame: Int[Array, ""],
    t: th.PlusThresholds,
) -> Weighed:
    """Evidence of each candidate with that of all others in view.

    Args:
      shortlist: Candidates of the rows.
      anchor: Object of each detection that is decided.
      is_anchor: Detections that speak for their surroundings with full weight.
      sightings: Detections.
      objects: Objects.
      pairs: What is known of every two of them.
      frame: Number of this frame.
      t: Weights.
    """
    width = shortlist.slot.shape[1]
    # A party is what a detection may be: its candidates, or the one object of an anchor.
    first = jnp.arange(width) == 0
    party = jnp.where(is_anchor[:, None], anchor[:, None], shortlist.slot)
    present = jnp.where(is_anchor[:, None], first, shortlist.valid)

    others = _Others(sightings, jnp.any(present, axis=1))
    o, p = shortlist.slot[:, :, None, None], others.of(party)[:, None]
    usable = shortlist.valid[:, :, None, None] & others.of(present)[:, None]
    usable &= others.is_other[:, None, :, None] & (o != p)
    covisible = _covisible_evidence(o, p, others, objects, pairs, frame, t.layout)
    spread = look_up(pairs.spread, o, p)
    related = usable & (spread < NO_RELATION)
    layout = _layout_evidence(
        look_up(pairs.relation, o, p), spread, look_up(pairs.log_ratio, o, p), others, t.layout
    )
    # Products with the weights of the parties: what they say, and how many they are.
    asked = jnp.stack(
        [jnp.where(related, layout, 0.0), jnp.where(usable, covisible, 0.0), related, usable],
        axis=1,
    )

    base, place = shortlist.base, shortlist.evidence.place
    # What looks wrong is no witness for the others: where a new arrangement lies like an old one,
    # its members would otherwise talk each other into being known. A rare class tells as looks do.
    looks = shortlist.evidence.looks
    looks += t.layout.witness_class * _class_rarity(sightings.class_id, objects)[:, None]
    credible = jax.nn.sigmoid(t.layout.witness_slope * (looks + t.layout.witness))
    is_gone = find_gone(anchor, is_anchor, sightings, pairs, t.layout)[shortlist.slot]
    moved = jnp.where(is_gone, t.layout.moved_gone, t.layout.moved)

    def ask(weight: Float[Array, "N C"]) -> _Around:
        lies, companions, num_related, num_usable = others.sum(asked, weight)
        lies = lies * _share(num_related, t.layout.partners)
        lies = t.layout.weight * jnp.clip(lies, -t.layout.best, t.layout.best)
        companions = companions * _share(num_usable, t.layout.covisible_partners)
        companions = t.layout.covisible_weight * companions
        # Whatever lies wrong may have been moved: looks can still show it.
        given_back = jnp.clip(place + lies, moved, t.layout.most) - (place + lies)
        return _Around(lies, companions, given_back)

    def believe(odds: Float[Array, "N C"], handicap: Array) -> Float[Array, "N C"]:
        new = t.decision.new - handicap
        odds = jnp.where(shortlist.valid, odds, -jnp.inf)
        most = jnp.maximum(jnp.max(odds, axis=1, keepdims=True), new)
        likely = jnp.exp(odds - most)
        return likely / (jnp.sum(likely, axis=1, keepdims=True) + jnp.exp(new - most))

    def reconsider(k: Array, before: tuple[_Around, Array]) -> tuple[_Around, Array]:
        around, _ = before
        goes_on = k < t.layout.rounds
        handicap = jnp.where(goes_on, t.layout.optimism * (1.0 - k / t.layout.rounds), 0.0)
        belief = believe(base + sum(around), handicap)
        weight = jnp.where(is_anchor[:, None], 1.0 * first, credible * belief)
        told = ask(jnp.where(present, weight, 0.0))
        return jax.tree.map(lambda now, old: jnp.where(goes_on, now, old), told, around), belief

    nothing = jnp.zeros_like(base)
    # What is believed in the end is one more turn, in which nobody is asked again.
    start = _Around(nothing, nothing, nothing), nothing
    around, belief = jax.lax.fori_loop(0, t.layout.rounds + 1, reconsider, start)
    evidence = Evidence(**vars(shortlist.evidence), **around._asdict())
    weighed = Weighed(base + sum(around), belief, evidence)
    return jax.tree.map(lambda leaf: jnp.where(shortlist.valid, leaf, 0.0), weighed)


class _Around(NamedTuple):
    """What `Evidence` has from the others in view, by the same names."""

    layout: Float[Array, "N C"]
    companions: Float[Array, "N C"]
    moved: Float[Array, "N C"]


def nothing_weighed(num: int) -> tuple[Shortlist, Weighed]:
    """What `evidence.shortlist` and `weigh_jointly` give of detections that are no open rows."""
    blank = jnp.zeros((num, NUM_CANDIDATES), jnp.float32)
    own = OwnEvidence(**dict.fromkeys(OwnEvidence.kinds(), blank))
    everything = Evidence(**dict.fromkeys(Evidence.kinds(), blank))
    slot, valid = blank.astype(jnp.int32), blank.astype(bool)
    return Shortlist(slot, valid, blank, blank, own), Weighed(blank, blank, everything)


class _Others:
    """The detections that each one asks, `W`: all, or the nearest of them where many are in view.

    So a frame of many detections takes time and memory by their number, not by its square.
    """

    def __init__(self, sightings: Sightings, speaks: Bool[Array, "N"]) -> None:
        """`speaks`: detections that have anything to say."""
        center, size, touches = sightings.center, sightings.size, sightings.touches
        row = jnp.arange(len(size))
        self._near: Int[Array, "N W"] | None = None
        if len(size) > NUM_WITNESSES:
            apart = squared_length(center[None] - center[:, None])
            askable = speaks[None] & (row[:, None] != row[None])
            nearest = jnp.where(askable, -apart, -jnp.inf)
            self._near = jax.lax.top_k(nearest, NUM_WITNESSES)[1]
        self.is_other = row[:, None] != self.of(row)
        self.offset = self.of(center) - center[:, None]
        self.squared = squared_length(self.offset)
        self.scale = jnp.sqrt(size)[:, None] * jnp.sqrt(self.of(size))
        self.log_ratio = jnp.log(size)[:, None] - jnp.log(self.of(size))
        self.border = touches[:, None] | self.of(touches)

    def of(self, values: Shaped[Array, "N *more"]) -> Shaped[Array, "#N W *more"]:
        """Values of the detections that each one asks."""
        values = jnp.asarray(values)
        return values[None] if self._near is None else values[self._near]

    def sum(
        self, said: Float[Array, "N K C W C"], weight: Float[Array, "N C"]
    ) -> Float[Array, "K N C"]:
        """Sums of what all of them say, each by its weight."""
        num, kinds, width = said.shape[:3]
        if self._near is None:
            flat = said.reshape(num * kinds * width, num * width)
            summed = jnp.matmul(flat, weight.reshape(-1), precision="highest")
        else:
            flat = said.reshape(num, kinds * width, NUM_WITNESSES * width)
            weights = self.of(weight).reshape(num, -1)
            summed = jnp.einsum("nhp,np->nh", flat, weights, precision="highest")
        return jnp.moveaxis(summed.reshape(num, kinds, width), 1, 0)


def _layout_evidence(
    relation: Float[Array, "N C W C 2"],
    spread: Float[Array, "N C W C"],
    log_ratio: Float[Array, "N C W C"],
    others: _Others,
    t: th.Layout,
) -> Float[Array, "N C W C"]:
    """Does the one lie from the other as these objects do? In sizes, so from afar as well."""
    border, scale = others.border[:, None, :, None], others.scale[:, None, :, None]
    error = relation_error(relation, spread, border, t)
    off = (others.offset / others.scale[..., None])[:, None, :, None] - relation
    squared = squared_length(off) * scale**2
    variance = (error * scale) ** 2
    odds = mix(squared, variance, t.lost, t.least_doubt, jnp.float32(0), th.FRAME_AREA)
    odds = jnp.clip(odds, -t.pair_best, t.pair_best)

    ratio_error = jnp.where(border, t.ratio_error_border, t.ratio_error)
    off_ratio = (others.log_ratio[:, None, :, None] - log_ratio) ** 2
    ratio_odds = -jnp.log(ratio_error) - off_ratio / (2 * ratio_error**2) + off_ratio / 2
    # What may have moved may have come nearer.
    known = 1.0 / (1.0 + (spread / t.ratio_spread) ** 2)
    return odds + t.ratio_weight * known * jnp.clip(ratio_odds, -2.0, 1.0)


def _class_rarity(class_id: Int[Array, "N"], objects: Objects) -> Float[Array, "N"]:
    """Log of how many objects there are per object of the same class: 0 if all are of one."""
    alike = objects.exists[None] & (class_id[:, None] == objects.class_id[None])
    of_class = jnp.sum(alike, axis=1, dtype=jnp.float32)
    of_all = jnp.sum(objects.exists, dtype=jnp.float32)
    return jnp.log(jnp.maximum(of_all, 1.0) / jnp.maximum(of_class, 1.0))


def _covisible_evidence(
    o: Int[Array, "N C 1 1"],
    p: Int[Array, "#N 1 W C"],
    others: _Others,
    objects: Objects,
    pairs: Pairs,
    frame: Int[Array, ""],
    t: th.Layout,
) -> Float[Array, "N C W C"]:
    """Are these objects seen together more often than by chance?"""
    together = look_up(pairs.covisible, o, p) + 0.5
    frames = jnp.minimum(objects.seen[o], objects.seen[p]) + 3.0
    # What is always in view is beside everybody; what came with another memory may be older.
    usual = jnp.minimum(jnp.maximum(objects.seen[o], objects.seen[p]) / jnp.maximum(frame, 1), 1.0)
    odds = jnp.log(together / frames / jnp.maximum(t.covisible_typical, usual))
    odds = jnp.clip(odds, -t.covisible_best, t.covisible_best)
    # The absence of a companion means little far away from it.
    nearness = jnp.exp(-others.squared / (2 * t.near**2))[:, None, :, None]
    return jnp.where(odds < 0, odds * nearness, odds)


def _share(num: Float[Array, "N C"], partners: Float[Array, ""]) -> Float[Array, "N C"]:
    """More than so many parties share what so many may say."""
    return jnp.minimum(1.0, partners / jnp.maximum(num, 1e-6))
