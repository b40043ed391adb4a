"""What the others in view say: how they lie, and who is usually seen with whom.

Rules: method_plus.md#layout-evidence, method_plus.md#company-evidence,
method_plus.md#joint-weighing.

All open tracklets of a frame are weighed together by mean field: what one of them may be depends on
what the others may be.

Letters: `N` detections, `C` candidates, `O` object slots, `W` detections that one asks. Evidence is
in log odds.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import count_up, in_turn
from remind_jax.numerics.plane import squared_length
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import count_before
from remind_jax.plus import thresholds as th
from remind_jax.plus.evidence import Evidence, OwnEvidence, Shortlist, mix, relation_error
from remind_jax.plus.observation import Sightings
from remind_jax.plus.own_movement import staying
from remind_jax.plus.slots import look_up, rows_of
from remind_jax.plus.state import NO_RELATION, Objects, Pairs, blank
from remind_jax.plus.static import NUM_CANDIDATES, NUM_WITNESSES
from remind_jax.plus.vacancy import find_gone

_AT_ONCE = 4  # open rows that are added up together
# How objects lie.
PARTNERS = 6.0  # partners that speak in full; more share this
MOST = 5.0  # most place and layout together, log odds
RELATION_LOST = 1.2  # spread at which half of the belief in a relation is gone, object sizes
RELATION_DOUBT = 0.05  # least chance that a relation no longer holds
PAIR_BEST = 3.0  # limit of the evidence of one partner, log odds
RATIO_WEIGHT = 0.5  # of the ratio of sizes
RATIO_SPREAD = 1.0  # spread of a relation that tells half as much of sizes, object sizes
RATIO_ERROR = 0.4  # standard deviation of the log ratio of sizes, ...
RATIO_ERROR_BORDER = 0.8  # ... and where a mask touches the border
# What is seen together.
COVISIBLE_PARTNERS = 2.0  # partners that speak in full; more share this
COVISIBLE_TYPICAL = 0.15  # share of frames that two objects share by chance
COVISIBLE_BEST = 1.5  # limit of the evidence, log odds
NEAR = 2.56  # length over which absence of a companion tells something


@pytree
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
    ticks: Int[Array, ""],
    t: th.PlusThresholds,
) -> Weighed:
    """Evidence of each candidate with that of all others in view.

    Args:
      anchor: Object of each detection that is decided.
      is_anchor: Detections that speak for their surroundings with full weight.
    """
    is_gone = find_gone(anchor, is_anchor, sightings, pairs, t.layout)[shortlist.slot]
    first = jnp.arange(shortlist.slot.shape[1]) == 0
    rows = _Rows(
        slot=shortlist.slot,
        valid=shortlist.valid,
        base=shortlist.base,
        place=shortlist.evidence.place,
        stays=staying(objects, t.mobility)[shortlist.slot],
        moved=jnp.where(is_gone, t.layout.moved_gone, t.layout.moved),
        is_anchor=is_anchor,
        party=jnp.where(is_anchor[:, None], anchor[:, None], shortlist.slot),
        present=jnp.where(is_anchor[:, None], first, shortlist.valid),
        center=sightings.center,
        size=sightings.size,
        touches=sightings.touches,
    )
    given = rows, objects.seen, pairs, ticks, t.layout, t.decision.new
    around, belief = in_turn(jnp.any(shortlist.valid), _weigh, *given)
    evidence = Evidence(**vars(shortlist.evidence), **around._asdict())
    weighed = Weighed(shortlist.base + sum(around), belief, evidence)
    return jax.tree.map(lambda leaf: jnp.where(shortlist.valid, leaf, 0.0), weighed)


class _Rows(NamedTuple):
    """What weighing together needs of the detections.

    A party is what a detection may be: its candidates, or the one object of an anchor.
    """

    slot: Int[Array, "N C"]  # of each candidate
    valid: Bool[Array, "N C"]
    base: Float[Array, "N C"]  # log odds of what it has alone
    place: Float[Array, "N C"]
    stays: Float[Array, "N C"]  # how far it may still be where it was left, [0, 1]
    moved: Float[Array, "N C"]  # log odds of what lies wrong
    is_anchor: Bool[Array, "N"]
    party: Int[Array, "N C"]  # slot of each party
    present: Bool[Array, "N C"]
    center: Float[Array, "N 2"]
    size: Float[Array, "N"]
    touches: Bool[Array, "N"]


def _weigh(
    rows: _Rows,
    seen: Int[Array, "O"],
    pairs: Pairs,
    ticks: Int[Array, ""],
    t: th.Layout,
    new: Float[Array, ""],
) -> tuple[_Around, Float[Array, "N C"]]:
    """What the others say of each candidate, and how far it is believed."""
    num, width = rows.slot.shape
    first = jnp.arange(width) == 0
    # Only open rows ask, often few of many; they stand one after the other.
    is_open = jnp.any(rows.valid, axis=1)
    place, num_open = count_before(is_open), jnp.sum(is_open)
    open_row = rows_of(place, is_open, num)
    num_asked, room = min(num, NUM_WITNESSES), -(-num // _AT_ONCE) * _AT_ONCE
    asked = jnp.zeros((room, num_asked), jnp.int32)
    kinds = len(_Said._fields)
    said = jnp.zeros((room, kinds, width, num_asked * width), jnp.float32)

    def hear(k: Array, heard: tuple[Array, Array]) -> tuple[Array, Array]:
        n = open_row[k]
        others = _nearest(n, rows, num_asked)
        asked, said = heard
        # Each kind is computed right where it goes to, in one loop that the compiler vectorizes.
        for kind, row in enumerate(_say(n, others, rows, seen, pairs, ticks, t)):
            said = lax.dynamic_update_slice(said, row[None, None], (k, kind, 0, 0))
        return lax.dynamic_update_index_in_dim(asked, others, k, axis=0), said

    asked, said = count_up(num_open, hear, (asked, said), suits_all=True)

    def ask(weight: Float[Array, "N C"]) -> _Around:
        def add_up(block: Array, sums: Array) -> Array:
            first = block * _AT_ONCE
            take = functools.partial(
                lax.dynamic_slice_in_dim, start_index=first, slice_size=_AT_ONCE
            )
            weights = weight[take(asked)].reshape(_AT_ONCE, -1)
            told = jnp.einsum("bkcw,bw->bkc", take(said), weights, precision="highest")
            return lax.dynamic_update_slice_in_dim(sums, told, first, axis=0)

        nothing = jnp.zeros((room, kinds, width), jnp.float32)
        sums = count_up(-(-num_open // _AT_ONCE), add_up, nothing, suits_all=True)
        sums = jnp.where(is_open[:, None, None], sums[place], 0.0)
        layout, companions, num_related, num_usable = jnp.moveaxis(sums, 1, 0)
        layout = layout * _share(num_related, PARTNERS)
        layout = t.weight * jnp.clip(layout, -t.best, t.best)
        layout = jnp.minimum(layout, rows.stays * layout)
        companions = companions * _share(num_usable, COVISIBLE_PARTNERS)
        companions = t.covisible_weight * companions
        # Whatever lies wrong may have been moved: looks can still show it.
        both = rows.place + layout
        return _Around(layout, companions, jnp.clip(both, rows.moved, MOST) - both)

    def believe(odds: Float[Array, "N C"]) -> Float[Array, "N C"]:
        odds = jnp.where(rows.valid, odds, -jnp.inf)
        most = jnp.maximum(jnp.max(odds, axis=1, keepdims=True), new)
        likely = jnp.exp(odds - most)
        return likely / (jnp.sum(likely, axis=1, keepdims=True) + jnp.exp(new - most))

    def reconsider(k: Array, before: tuple[_Around, Array]) -> tuple[_Around, Array]:
        around, _ = before
        goes_on = k < t.rounds
        belief = believe(rows.base + sum(around))
        weight = jnp.where(rows.is_anchor[:, None], 1.0 * first, belief)
        told = ask(jnp.where(rows.present, weight, 0.0))
        return jax.tree.map(lambda now, old: jnp.where(goes_on, now, old), told, around), belief

    nothing = jnp.zeros_like(rows.base)
    # What is believed in the end is one more turn, in which nobody is asked again.
    start = _Around(nothing, nothing, nothing), nothing
    return count_up(t.rounds + 1, reconsider, start, suits_all=True)


class _Around(NamedTuple):
    """What `Evidence` has from the others in view, by the same names."""

    layout: Float[Array, "N C"]
    companions: Float[Array, "N C"]
    moved: Float[Array, "N C"]


def nothing_weighed(num: int) -> tuple[Shortlist, Weighed]:
    """What `evidence.shortlist` and `weigh_jointly` give of detections that are no open rows."""
    sizes = {"N": num, "C": NUM_CANDIDATES, "X": NUM_CANDIDATES}
    return (
        blank(Shortlist, sizes, evidence=blank(OwnEvidence, sizes)),
        blank(Weighed, sizes, evidence=blank(Evidence, sizes)),
    )


def _nearest(n: Int[Array, ""], rows: _Rows, most: int) -> Int[Array, "W"]:
    """The detections that one asks: all, or the nearest that have anything to say.

    So a frame of many detections takes time and memory by their number, not by its square.
    """
    num = len(rows.size)
    index = jnp.arange(num, dtype=jnp.int32)
    if num <= most:
        return index
    askable = jnp.any(rows.present, axis=1) & (index != n)
    apart = squared_length(rows.center - rows.center[n])
    return lax.top_k(jnp.where(askable, -apart, -jnp.inf), most)[1]


def _say(
    n: Int[Array, ""],
    others: Int[Array, "W"],
    rows: _Rows,
    seen: Int[Array, "O"],
    pairs: Pairs,
    ticks: Int[Array, ""],
    t: th.Layout,
) -> _Said:
    """What every party of the others says of every candidate of one row."""
    m, size, touches = others[:, None], rows.size, rows.touches
    beside = _Beside(
        offset=rows.center[m] - rows.center[n],
        scale=jnp.sqrt(size[n]) * jnp.sqrt(size[m]),
        log_ratio=jnp.log(size[n]) - jnp.log(size[m]),
        border=touches[n] | touches[m],
    )
    o, p = rows.slot[n][:, None, None], rows.party[others]
    usable = rows.valid[n][:, None, None] & rows.present[others]
    usable &= (m != n) & (o != p)
    spread = look_up(pairs.spread, o, p)
    related = usable & (spread < NO_RELATION)
    layout = _layout_evidence(
        look_up(pairs.relation, o, p), spread, look_up(pairs.log_ratio, o, p), beside, t
    )
    covisible = _covisible_evidence(look_up(pairs.covisible, o, p), seen[o], seen[p], beside, ticks)
    said = _Said(
        jnp.where(related, layout, 0.0), jnp.where(usable, covisible, 0.0), related, usable
    )
    return jax.tree.map(lambda leaf: leaf.reshape(len(o), -1).astype(jnp.float32), said)


class _Said(NamedTuple):
    """What parties say of candidates; an array each, of which each is computed as one loop."""

    layout: Float[Array, "... C WC"]  # how they lie
    companions: Float[Array, "... C WC"]  # whether they are seen together
    is_related: Float[Array, "... C WC"]  # 1 where the first says anything
    is_usable: Float[Array, "... C WC"]  # 1 where the second does


class _Beside(NamedTuple):
    """How the others lie from the one that asks."""

    offset: Float[Array, "W 1 2"]
    scale: Float[Array, "W 1"]  # geometric mean of the sizes
    log_ratio: Float[Array, "W 1"]
    border: Bool[Array, "W 1"]  # one of them touches it


def _layout_evidence(
    relation: Float[Array, "C W C 2"],
    spread: Float[Array, "C W C"],
    log_ratio: Float[Array, "C W C"],
    beside: _Beside,
    t: th.Layout,
) -> Float[Array, "C W C"]:
    """Does the one lie from the other as these objects do? In sizes, so from afar as well."""
    border, scale = beside.border, beside.scale
    error = relation_error(relation, spread, border, t)
    off = beside.offset / scale[..., None] - relation
    squared = squared_length(off) * scale**2
    variance = (error * scale) ** 2
    odds = mix(squared, variance, RELATION_LOST, RELATION_DOUBT, 0.0)
    odds = jnp.clip(odds, -PAIR_BEST, PAIR_BEST)

    ratio_error = jnp.where(border, RATIO_ERROR_BORDER, RATIO_ERROR)
    off_ratio = (beside.log_ratio - log_ratio) ** 2
    ratio_odds = -jnp.log(ratio_error) - off_ratio / (2 * ratio_error**2) + off_ratio / 2
    # What may have moved may have come nearer.
    known = 1.0 / (1.0 + (spread / RATIO_SPREAD) ** 2)
    return odds + RATIO_WEIGHT * known * jnp.clip(ratio_odds, -2.0, 1.0)


def _covisible_evidence(
    covisible: Float[Array, "C W C"],
    seen: Int[Array, "C 1 1"],
    seen_party: Int[Array, "W C"],
    beside: _Beside,
    ticks: Int[Array, ""],
) -> Float[Array, "C W C"]:
    """Are these objects seen together more often than by chance?"""
    together = covisible + 0.5
    frames = jnp.minimum(seen, seen_party) + 3.0
    # What is always in view is beside everybody; what came with another memory may be older.
    usual = jnp.minimum(jnp.maximum(seen, seen_party) / jnp.maximum(ticks, 1), 1.0)
    odds = jnp.log(together / frames / jnp.maximum(COVISIBLE_TYPICAL, usual))
    odds = jnp.clip(odds, -COVISIBLE_BEST, COVISIBLE_BEST)
    # The absence of a companion means little far away from it.
    nearness = jnp.exp(-squared_length(beside.offset) / (2 * NEAR**2))
    return jnp.where(odds < 0, odds * nearness, odds)


def _share(num: Float[Array, "N C"], partners: float) -> Float[Array, "N C"]:
    """More than so many parties share what so many may say."""
    return jnp.minimum(1.0, partners / jnp.maximum(num, 1e-6))
