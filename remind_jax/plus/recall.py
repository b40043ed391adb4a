"""Which objects come back to the working set, and which make room for them (host).

Rule: method_plus.md#recall.

Before a frame is decided, the archive is asked for the looks of what no decided tracklet goes on
with. The objects that look most alike come, and with them whom they stand beside, so that a place
is recognized as a group.

Letters: `N` detections, `O` object slots, `T` tracklets, `Q` looks that are asked for, `L` rows of
classes, `A` looks under each name.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.plus.archive import Archive, Snapshot
from remind_jax.plus.look_index import Whitener
from remind_jax.plus.one_thread import on_one_thread
from remind_jax.plus.state import PlusState, Scene, Tracklets, init
from remind_jax.plus.static import num_tracklets
from remind_jax.plus.thresholds import FRAME_AREA
from remind_jax.static import Static

NUM_ASKED = 4  # objects at rest that each look may bring
# What comes looks more like the same than like another object: this share of the way between what
# cosines of both are usually. With what lies beyond the second come those it stands beside.
PLAUSIBLE, CLEAR = 0.3, 0.6
USUAL = np.array([0.1, 0.7], np.float32)  # cosines of others and of the same, before any is known
USUAL_WEIGHT = 20.0  # cosines that this counts for
BEHIND = 0.25  # what looks by so much less alike than another candidate does not come
OTHER_NAME = 0.02  # share of frames from which on a class is known to change to another one
FOLLOWED_OVERLAP, FOLLOWED_COSINE = 0.3, 0.5  # what plainly goes on with a tracklet
ASKED_AGAIN = (2, 5)  # is asked for at these numbers of detections, while it is open
# Objects this near the middle of a square frame are in the working set while their place is known.
IN_REACH = 1.5 * FRAME_AREA**0.5
KNOWN_PLACE = 1.0  # largest variance of a place that is known, in squares of frame units
MOST_SHARE = 2  # at most one of so many slots is filled at once
SPARE_SHARE = 8  # one of so many slots is made free beyond those that are needed


class ObjectsAtRest(Archive):
    """The archive of one memory: chooses what rests and what comes, and knows when that came."""

    def __init__(self) -> None:
        """Nothing rests yet."""
        super().__init__()
        self._came: dict[int, int] = {}  # frame in which an object was last brought

    def make_room(
        self, state: PlusState, seen: Any, static: Static, needed: int
    ) -> PlusState | None:
        """Rests what was longest out of view until so many slots suffice.

        What looks like a detection of the frame goes last.

        Args:
          state: The memory before the frame, on the host.
          seen: The frame as `describe` gives it.
          needed: Slots that the frame needs in all.

        Returns:
          The memory; None if all that could rest is not enough.
        """
        state = jax.device_get(state)
        lacking = needed - static.num_objects
        idle = self._idle(state)
        if lacking > len(idle):
            return None
        alike = self._wanted(state, *_asked(state, seen))[1]
        idle.sort(key=lambda slot: alike[slot])
        spare = static.num_objects // SPARE_SHARE
        return self._rest(state, static, idle[: max(0, lacking) + spare])

    def rest(self, state: PlusState, static: Static, num: int) -> PlusState:
        """Rests what was longest out of view, so many at most."""
        state = jax.device_get(state)
        return self._rest(state, static, self._idle(state)[:num])

    def shrink(self, state: PlusState, static: Static, smaller: Static) -> PlusState | None:
        """Moves the memory into smaller capacities; None if what is in use has no room there.

        Args:
          state: The memory, on the host, whose last frames had no more detections than there are
            slots for then.
        """
        state = jax.device_get(state)
        frame_rows = smaller.num_detections
        waiting = state.tracklets.alive[frame_rows:]
        if waiting.sum() > num_tracklets(smaller) - frame_rows:
            return None
        most = smaller.num_objects - smaller.num_objects // SPARE_SHARE
        excess = int(state.objects.exists.sum()) - most
        idle = self._idle(state)
        if excess > len(idle):
            return None
        state = self._rest(state, static, idle[: max(0, excess)])
        # What is in use comes first, in the order in which it was.
        first = np.argsort(~state.objects.exists, kind="stable")
        place_of = np.argsort(first).astype(state.tracklets.slot.dtype)
        rows = np.concatenate(
            [np.arange(frame_rows), frame_rows + np.argsort(~waiting, kind="stable")]
        )
        tracklets = jax.tree.map(lambda leaf: leaf[rows], state.tracklets)
        holds = tracklets.alive & (tracklets.slot != NO_SLOT)
        moved = dataclasses.replace(
            state,
            objects=jax.tree.map(lambda leaf: leaf[first], state.objects),
            pairs=jax.tree.map(lambda leaf: leaf[np.ix_(first, first)], state.pairs),
            tracklets=dataclasses.replace(
                tracklets, slot=np.where(holds, place_of[tracklets.slot], NO_SLOT)
            ),
        )
        return jax.tree.map(
            lambda leaf, room: leaf[tuple(map(slice, room.shape))], moved, _empty(smaller)
        )

    def recall(self, state: PlusState, seen: Any, static: Static) -> PlusState | None:
        """Brings what the detections of the next frame may be; None if nothing comes.

        Args:
          state: The memory before the frame, on the host.
          seen: The frame as `describe` gives it.
        """
        if not len(self):
            return None
        sightings, rows = _asked(state, seen)
        if not len(rows):
            return None
        wanted, alike = self._wanted(state, sightings, rows)
        if not wanted:
            return None
        state = jax.device_get(state)
        exists = int((state.objects.id != NO_ID).sum())
        open_ones = int((state.tracklets.alive & (state.tracklets.slot == NO_SLOT)).sum())
        free = static.num_objects - exists - open_ones - int(sightings.valid.sum())
        idle = [slot for slot in self._idle(state) if not alike[slot]]
        most = min(free + len(idle), static.num_objects // MOST_SHARE)
        wanted = wanted[: max(0, most)]
        if not wanted:
            return None
        state = self._rest(state, static, idle[: max(0, len(wanted) - free)])
        present = set(state.objects.id.tolist())
        before = {one: frame for one, frame in self._came.items() if one in present}
        self._came = before | dict.fromkeys(wanted, int(state.frame))
        return self.wake(state, wanted, np.asarray(sightings.frame_center))

    def tensors(self, since: Snapshot | None = None) -> dict[str, np.ndarray]:
        """What changed as arrays by name, for a file; everything if `since` is left out."""
        came = np.array([*self._came.items()], np.int32).reshape(-1, 2)
        return super().tensors(since) | ({"came": came} if len(came) else {})

    def restore(
        self, parts: Sequence[Mapping[str, np.ndarray]], state: PlusState, num_classes: int
    ) -> None:
        """As `Archive.restore`."""
        super().restore(parts, state, num_classes)
        came = parts[-1].get("came", np.zeros((0, 2), np.int32))
        self._came = dict(came.tolist())

    @on_one_thread
    def _wanted(
        self, state: PlusState, sightings: Any, rows: Int[np.ndarray, "Q"]
    ) -> tuple[list[int], Bool[np.ndarray, "O"]]:
        """Ids of objects at rest by falling promise, and slots of objects that look alike as well.

        What looks alike comes first, then its partners.
        """
        index = self.looks(state)
        votes: dict[int, float] = {}
        alike: dict[int, float] = {}
        bank = np.asarray(state.objects.white_bank)
        filled = np.asarray(state.objects.bank_count) > 0
        plausible = _usual_cosines(state.scene, PLAUSIBLE)
        clear = _usual_cosines(state.scene, CLEAR)
        names = np.asarray(state.scene.names)
        present_ids = np.asarray(state.objects.class_id)
        known = {*index.class_ids, *present_ids[np.asarray(state.objects.exists)].tolist()}
        of_row, class_id = _names_of(sightings.class_id[rows], known, names)
        if not len(of_row):
            return [], np.zeros(len(bank), bool)
        looks = sightings.look[rows[of_row]]
        found, cosine = index.search(looks, class_id, NUM_ASKED)
        white = Whitener.of(state.scene).whiten(looks, class_id)
        present = white @ bank.reshape(-1, bank.shape[-1]).T
        same = filled & (class_id[:, None, None] == present_ids[:, None])
        present = np.where(same, present.reshape(same.shape), -1.0).max(axis=2)
        best = np.full(len(rows), -1.0, np.float32)
        np.maximum.at(best, of_row, np.maximum(present.max(axis=1), cosine[:, 0]))
        least = np.maximum(plausible, best[of_row, None] - BEHIND)
        comes = cosine > least
        for one, value in zip(found[comes].tolist(), cosine[comes].tolist(), strict=True):
            alike[one] = max(alike.get(one, -1.0), value)
        for one, value in alike.items():
            if value > clear:
                for partner in self.partners(one):
                    beside = int(partner["id"])
                    votes[beside] = votes.get(beside, 0.0) + value * float(partner["covisible"])
        company = [one for one in votes if one in self and one not in alike]
        first = sorted(alike, key=lambda one: -alike[one])
        wanted = [*first, *sorted(company, key=lambda one: -votes[one])]
        return wanted, np.any(present > least, axis=0)

    def _idle(self, state: PlusState) -> list[int]:
        """Slots of objects that no tracklet holds, those that were longest not needed first.

        What an open one was answered as in the last frame, it holds as well.
        """
        objects, tracklets = state.objects, state.tracklets
        held = np.isin(objects.id, state.answers.answer_id)
        held[tracklets.slot[tracklets.alive & (tracklets.slot != NO_SLOT)]] = True
        came = np.array([self._came.get(int(one), 0) for one in objects.id])
        needed = np.maximum(objects.last, came)
        away = np.linalg.norm(objects.position - FRAME_AREA**0.5 / 2, axis=1)
        near = (away < IN_REACH) & (np.diagonal(state.pairs.covariance) < KNOWN_PLACE)
        needed = np.where(near, np.maximum(needed, int(state.frame) - 1), needed)
        idle = np.flatnonzero((objects.id != NO_ID) & ~held)
        order = np.lexsort((objects.id[idle], needed[idle]))
        return idle[order].tolist()

    def _rest(self, state: PlusState, static: Static, slots: list[int]) -> PlusState:
        return self.rest_slots(state, _empty(static), slots) if slots else state


@functools.lru_cache(maxsize=4)
def _empty(static: Static) -> PlusState:
    return jax.device_get(init(static))


def _names_of(
    class_id: Int[np.ndarray, "Q"], known: Collection[int], names: Float[np.ndarray, "L L"]
) -> tuple[Int[np.ndarray, "A"], Int[np.ndarray, "A"]]:
    """The classes that each look is asked for under: its own, and names that change with it.

    Args:
      known: Classes of all objects.
      names: Times that a tracklet of one class went on as another.

    Returns:
      Number of the look, and a class.
    """
    changes = names + names.T
    total = changes.sum(axis=1) + USUAL_WEIGHT
    often = changes > OTHER_NAME * np.sqrt(total[:, None] * total)
    np.fill_diagonal(often, False)  # a class goes on as itself, as do those that share a row
    num = len(names)
    asked = [
        (look, other)
        for look, own in enumerate(class_id.tolist())
        for other in known
        if own == other or often[own % num, other % num]
    ]
    of_look, other = np.array(asked, int).reshape(-1, 2).T
    return of_look, other


def _usual_cosines(scene: Scene, share: float) -> float:
    """What lies this share of the way from cosines of others to those of the same object."""
    weight = np.asarray(scene.cosine_weight) + USUAL_WEIGHT
    other, same = (np.asarray(scene.cosine_sum) + USUAL * USUAL_WEIGHT) / weight
    return float(other + share * (same - other))


def _asked(state: PlusState, seen: Any) -> tuple[Any, Int[np.ndarray, "Q"]]:
    """The detections of a frame on the host, and which of them are asked for."""
    sightings = jax.device_get(seen.sightings)
    followed = _followed(state, sightings, np.asarray(seen.motion.matrix))
    return sightings, np.flatnonzero(sightings.valid & ~followed)


@on_one_thread
def _followed(state: PlusState, sightings: Any, matrix: np.ndarray) -> Bool[np.ndarray, "N"]:
    """Detections that plainly go on with a tracklet that need not be asked for."""
    tracklets: Tracklets = jax.device_get(state.tracklets)
    is_due = tracklets.is_open & np.isin(tracklets.age, ASKED_AGAIN)
    rows = np.flatnonzero(tracklets.alive & ~is_due)
    middle = (tracklets.box[rows, :2] + tracklets.box[rows, 2:]) / 2
    shift = middle @ matrix[:, :2].T + matrix[:, 2] - middle
    box = tracklets.box[rows] + np.tile(shift, 2)
    low = np.maximum(sightings.box[:, None, :2], box[None, :, :2])
    high = np.minimum(sightings.box[:, None, 2:], box[None, :, 2:])
    inner = np.prod(np.maximum(high - low, 0.0), axis=2)
    areas = [np.prod(one[:, 2:] - one[:, :2], axis=1) for one in (sightings.box, box)]
    overlap = inner / np.maximum(areas[0][:, None] + areas[1][None] - inner, 1e-6)
    alike = sightings.class_id[:, None] == tracklets.class_id[None, rows]
    goes_on = sightings.valid[:, None] & alike & (overlap > FOLLOWED_OVERLAP)
    if not goes_on.any():
        return goes_on.any(axis=1)
    whitener = Whitener.of(state.scene)
    looks = np.concatenate([sightings.look, tracklets.look[rows]])
    white = whitener.whiten(looks, np.concatenate([sightings.class_id, tracklets.class_id[rows]]))
    num = len(sightings.look)
    return (goes_on & (white[:num] @ white[num:].T > FOLLOWED_COSINE)).any(axis=1)
