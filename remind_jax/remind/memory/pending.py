"""Tracks of detections that stay undecided (method.md#pending-tracks).

They give undecided detections of successive frames one id and a memory of their own; they never
decide an identity. Tracks never expire. Letters: `N` detections, `P` pending slots, `K = 3`.
"""

from __future__ import annotations

import dataclasses
import enum

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import NUM_OPTIONS
from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.numerics.constant_arrays import full, zeros
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pytree import choose, pytree
from remind_jax.numerics.ranks import count_before
from remind_jax.numerics.reductions import reduce_together
from remind_jax.remind.memory.writing import find_writers, write_column
from remind_jax.remind.thresholds.outcome import Pending as Rules
from remind_jax.solvers.assignment import assign

_TINY = 1e-12


class Kind(enum.IntEnum):
    """What a pending track waits for."""

    FREE = 0
    AMBIGUOUS = 1  # one of several known objects
    PROVISIONAL = 2  # new, or a known object after all


@pytree
class Items:
    """Undecided detections of a frame, as rows of `PendingTracks`."""

    kind: Int[Array, "N"]  # Kind, FREE for decided detections
    class_id: Int[Array, "N"]
    from_parent: Bool[Array, "N"]  # provisional: probably a known object
    id: Int[Array, "N"]  # of the track, -1 in free slots
    hits: Int[Array, "N"]
    known_id: Int[Array, "N K"]  # objects that it could be, or that support it; -1 padding
    known_score: Float[Array, "N K"]
    center: Float[Array, "N 2"]  # of the last detection, pixels
    area: Float[Array, "N"]  # pixels

    @classmethod
    def begun(cls, **columns: Array) -> Items:
        """Detections that are in no track yet; the other columns by name."""
        num, scalar = len(columns["known_id"]), columns["known_score"].dtype
        columns |= {name: columns[name].astype(scalar) for name in ("center", "area")}
        return cls(id=full(num, NO_ID, np.int32), hits=zeros(num, np.int32), **columns)


@pytree
class PendingTracks(Items):
    """One row per pending track; ids count up separately for each kind."""

    next_id: Int[Array, "2"]  # next ambiguous and next provisional id


# What a free slot forgets of its track.
_FREE = {"kind": Kind.FREE, "class_id": NO_ID, "id": NO_ID, "known_id": NO_ID}
_OWN = ("id", "hits")  # columns that a track keeps when a detection joins it


def no_pending(slots: int, scalar: jnp.dtype) -> PendingTracks:
    """A pool without tracks."""
    return PendingTracks(
        kind=full(slots, Kind.FREE, np.int32),
        class_id=full(slots, NO_ID, np.int32),
        from_parent=zeros(slots, np.bool_),
        id=full(slots, NO_ID, np.int32),
        hits=zeros(slots, np.int32),
        known_id=full((slots, NUM_OPTIONS), NO_ID, np.int32),
        known_score=zeros((slots, NUM_OPTIONS), scalar),
        center=zeros((slots, 2), scalar),
        area=zeros(slots, scalar),
        next_id=zeros(2, np.int32),
    )


def join_tracks(
    tracks: PendingTracks,
    items: Items,
    visual: Float[Array, "N P"],
    rules: Rules,
    *,
    solver: str,
) -> Int[Array, "N"]:
    """Track that each undecided detection continues, -1 for none (method.md#pending-joins)."""
    affinity, valid, same = _affinity(tracks, items, visual, rules)
    # Non-items form a group of their own that has no allowed pair.
    waiting = items.kind != Kind.FREE
    group = jnp.where(waiting, 2 * items.class_id + items.kind, -1)
    nothing = jnp.zeros(len(group), affinity.dtype)

    # Equal sums fall by the order of the tracks: that of their creation, free slots last.
    created = jnp.where(tracks.kind == Kind.FREE, jnp.iinfo(jnp.int32).max, tracks.id)
    age = jnp.argsort(created, stable=True).astype(jnp.int32)

    def solve() -> Int[Array, "N"]:
        pairs = (affinity[:, age], valid[:, age], group, nothing, jnp.zeros((), bool))
        column = assign(*pairs, same[:, age], solver=solver)
        return jnp.where(column == NO_SLOT, NO_SLOT, age[column])

    def skip() -> Int[Array, "N"]:
        return jnp.full(len(group), NO_SLOT, jnp.int32)

    return branch(jnp.any(valid), solve, skip, suits_all=True)


def _affinity(
    tracks: PendingTracks, items: Items, visual: Float[Array, "N P"], rules: Rules
) -> tuple[Float[Array, "N P"], Bool[Array, "N P"], Bool[Array, "N P"]]:
    """How well each track continues in each detection, whether it may, and which are of a kind."""
    ambiguous = (items.kind == Kind.AMBIGUOUS)[:, None]
    same = (items.kind[:, None] == tracks.kind[None]) & (items.kind != Kind.FREE)[:, None]
    same = same & (items.class_id[:, None] == tracks.class_id[None])
    (num_items, total_items), (num_tracks, total_tracks) = _add_up(items), _add_up(tracks)
    overlap, one_sided, neither = dice(items.known_id, tracks.known_id, num_items, num_tracks)
    scores = _score_overlap(items, tracks, total_items, total_tracks)
    scores = jnp.where(
        neither, jnp.where(~ambiguous & rules.provisional_without_parent, 1.0, 0.0), scores
    )
    place = _place(items, tracks)

    def of_kind(name: str) -> Array:
        kinds = (getattr(rules, f"{kind}_{name}") for kind in ("ambiguous", "provisional"))
        return jnp.where(ambiguous, *kinds)

    shared = jnp.where(neither, rules.provisional_without_parent, ~one_sided & (overlap > 0))
    fits = jnp.where(ambiguous, overlap >= rules.ambiguous_min_overlap, shared)
    fits = fits & (visual >= of_kind("min_visual")) & of_kind("matching")
    beside = of_kind("overlap_weight") * overlap + of_kind("scores_weight") * scores
    total = visual + (beside + of_kind("place_weight") * place)
    return total, same & fits & (total >= of_kind("min_total")), same


def dice(
    left: Int[Array, "N K"],
    right: Int[Array, "P K"],
    num_left: Int[Array, "N"],
    num_right: Int[Array, "P"],
) -> tuple[Float[Array, "N P"], Bool[Array, "N P"], Bool[Array, "N P"]]:
    """Dice overlap of two sets of ids, -1 padding; whether one is empty, and whether both are."""
    shared = (left[:, None, :, None] == right[None, :, None, :]) & (left >= 0)[:, None, :, None]
    common = jnp.sum(shared, axis=(2, 3))
    total = num_left[:, None] + num_right
    overlap = jnp.where(total > 0, 2.0 * common / jnp.maximum(total, 1), 0.0)
    empty_left, empty_right = (num_left == 0)[:, None], num_right == 0
    return overlap, empty_left != empty_right, empty_left & empty_right


def _add_up(named: Items) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """How many objects each row names, and the sum of their scores."""
    is_named = named.known_id >= 0
    return reduce_together(("sum", is_named), ("sum", _scores(named)), axis=1)


def _scores(named: Items) -> Float[Array, "N K"]:
    return jnp.where(named.known_id >= 0, jnp.maximum(named.known_score, 0.0), 0.0)


def _score_overlap(
    items: Items,
    tracks: PendingTracks,
    total_items: Float[Array, "N"],
    total_tracks: Float[Array, "P"],
) -> Float[Array, "N P"]:
    """Weighted overlap of two score maps over the union of their ids (method.md#pending-joins)."""
    same = items.known_id[:, None, :, None] == tracks.known_id[None, :, None, :]
    same = same & (items.known_id >= 0)[:, None, :, None]
    smaller = jnp.minimum(_scores(items)[:, None, :, None], _scores(tracks)[None, :, None, :])
    common = jnp.sum(jnp.where(same, smaller, 0.0), axis=(2, 3))
    total = total_items[:, None] + total_tracks
    return jnp.where(total > _TINY, 2.0 * common / jnp.maximum(total, _TINY), 0.0)


def _place(items: Items, tracks: PendingTracks) -> Float[Array, "N P"]:
    """Nearness and likeness in size, [0, 1] (method.md#pending-joins)."""
    mine, theirs = items.area[:, None], tracks.area[None]
    scale = jnp.maximum(1.0, jnp.sqrt(0.5 * (mine + theirs)))
    offset = items.center[:, None] - tracks.center[None]
    distance = jnp.sqrt(jnp.sum(offset * offset, axis=-1))
    near = jnp.maximum(0.0, 1.0 - jnp.minimum(1.0, distance / (2.5 * scale)))
    size = jnp.minimum(mine, theirs) / jnp.maximum(jnp.maximum(mine, theirs), _TINY)
    return jnp.where((mine > 0) & (theirs > 0), 0.65 * near + 0.35 * size, 0.0)


def open_tracks(
    tracks: PendingTracks, items: Items, joined: Int[Array, "N"]
) -> tuple[Int[Array, "N"], Int[Array, ""]]:
    """Gives a free slot to each undecided detection that continues no track.

    Returns the slot of each, `P` for the others and those that do not fit, and the slots needed.
    """
    slots = tracks.kind.shape[0]
    fresh = (items.kind != Kind.FREE) & (joined == NO_SLOT)
    free = tracks.kind == Kind.FREE
    turn, place = count_before(fresh), count_before(free)
    taken = fresh[:, None] & free & (turn[:, None] == place)
    opened = jnp.min(jnp.where(taken, jnp.arange(slots, dtype=jnp.int32), slots), axis=1)
    needed = slots - (place[-1] + free[-1]) + turn[-1] + fresh[-1]
    return jnp.where(joined == NO_SLOT, opened, joined), needed


def write_tracks(
    tracks: PendingTracks, items: Items, slot: Int[Array, "N"], joined: Int[Array, "N"]
) -> PendingTracks:
    """Notes the undecided detections in their tracks; new tracks get ids by rising detection."""
    slots = tracks.kind.shape[0]
    fresh = joined == NO_SLOT
    kinds = jnp.array([Kind.AMBIGUOUS, Kind.PROVISIONAL])[:, None]
    born = fresh & (slot < slots) & (items.kind == kinds)
    new_id = jnp.sum(jnp.where(born, tracks.next_id[:, None] + count_before(born), 0), axis=0)

    writers = find_writers(slot, slots)
    begins = dataclasses.replace(writers, written=writers.written & fresh[writers.detection])
    begun = dataclasses.replace(items, id=new_id, hits=jnp.ones_like(new_id))
    columns = {
        field.name: write_column(
            getattr(tracks, field.name),
            begins if field.name in _OWN else writers,
            getattr(begun, field.name),
        )
        for field in dataclasses.fields(Items)
    }
    columns["hits"] += writers.written
    return PendingTracks(**columns, next_id=tracks.next_id + jnp.sum(born, axis=1, dtype=jnp.int32))


def end_tracks(tracks: PendingTracks, ended: Bool[Array, "P"]) -> PendingTracks:
    """Frees the slots of tracks."""
    freed = choose(ended, _FREE, {name: getattr(tracks, name) for name in _FREE})
    return dataclasses.replace(tracks, **freed)
