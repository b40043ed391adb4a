"""Objects at rest: what the step has no room for lies on the host, and comes back as it was (host).

Rule: method_plus.md#archive.

What was learned of an object is copied both ways without loss. Of its relations to others those to
its nearest partners are kept, so that the archive grows with the number of objects, not with its
square. Where it lies in the image is not known any more after a rest.

Letters: `O` object slots, `K` kept looks per object, `D` feature dimension, `P` partners.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import jax
import numpy as np
from jaxtyping import Float, Int

from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.plus.forgetting import clear_objects
from remind_jax.plus.look_index import LookIndex, Owner, Whitener
from remind_jax.plus.state import NO_RELATION, Objects, Pairs, PlusState

MAX_PARTNERS = 24  # others that an object is remembered beside: those it was seen with most
UNKNOWN_PLACE = 100.0  # variance of a position that is not known, in squares of frame units
# Looks are whitened anew after half as many ticks again, and after so many: directions that tell
# objects apart are learned from some thousand looks, and forgotten for those of other places.
MAX_TICKS = 1000

_PARTNER = np.dtype(
    [
        ("id", "i4"),
        ("covisible", "f4"),
        ("relation", "f4", (2,)),
        ("spread", "f4"),
        ("log_ratio", "f4"),
    ]
)
NO_PARTNERS = np.zeros(0, _PARTNER)
# What is copied of an object as it is; its looks are kept apart, its place is not kept.
_COPIED = tuple(
    field.name
    for field in dataclasses.fields(Objects)
    if field.name not in ("position", "bank", "bank_count", "white_bank")
)


@dataclasses.dataclass(frozen=True)
class Resting:
    """An object as it was in the working set."""

    values: dict[str, np.ndarray]  # fields of `Objects` of the same names
    bank: Float[np.ndarray, "K D"]  # kept looks; free places are left out
    bank_count: Int[np.ndarray, "K"]

    @property
    def id(self) -> int:
        """Its id."""
        return int(self.values["id"])

    @property
    def owner(self) -> Owner:
        """It and its looks."""
        return Owner(self.id, int(self.values["class_id"]), self.bank)


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """What an archive held at some time; what it holds is replaced, never changed."""

    resting: Mapping[int, Resting] = dataclasses.field(default_factory=dict)
    partners: Mapping[int, np.ndarray] = dataclasses.field(default_factory=dict)
    whitener: Whitener | None = None


class Archive:
    """All objects at rest, by id, and whom each object was seen with."""

    def __init__(self) -> None:
        """Nothing rests."""
        self._looks: LookIndex | None = None
        self._resting: dict[int, Resting] = {}
        self._partners: dict[int, np.ndarray] = {}  # of objects that rest or rested

    def __len__(self) -> int:
        return len(self._resting)

    def __contains__(self, object_id: int) -> bool:
        return object_id in self._resting

    def ids(self) -> list[int]:
        """Ids of all objects at rest."""
        return list(self._resting)

    def num_bytes(self) -> int:
        """Bytes of what is kept of the objects, of partners, and of looks to be found by."""
        partners = sum(map(len, self._partners.values())) * _PARTNER.itemsize
        if not self._resting:
            return partners
        one = next(iter(self._resting.values()))
        of_one = sum(value.nbytes for value in one.values.values())
        looks = sum(len(one.bank) for one in self._resting.values())
        of_look = one.bank.shape[-1] * one.bank.itemsize + one.bank_count.itemsize
        of_look += 0 if self._looks is None else self._looks.bytes_of_look
        return partners + len(self) * of_one + looks * of_look

    def looks(self, state: PlusState) -> LookIndex:
        """Looks of all of them, whitened anew if that is due; `state` is the memory beside it."""
        now = int(state.ticks)
        if self._looks is None or now - self._looks.ticks > min(self._looks.ticks / 2, MAX_TICKS):
            self._looks = LookIndex(Whitener.of(state.scene), now)
            self._looks.add([one.owner for one in self._resting.values()])
        return self._looks

    def partners(self, object_id: int) -> np.ndarray:
        """Whom it was seen with, as far as it rested since: fields `id`, `covisible` and others."""
        return self._partners.get(object_id, NO_PARTNERS)

    def rest_slots(self, state: PlusState, empty: PlusState, slots: Sequence[int]) -> PlusState:
        """Takes objects out of a memory of host arrays; gives the memory without them.

        Args:
          state: The memory; no tracklet holds these objects.
          empty: A memory without objects, of the same capacities.
        """
        objects, pairs = state.objects, state.pairs
        for slot in slots:
            self._partners[int(objects.id[slot])] = self._partners_of(objects, pairs, slot)
        self._put([_copied(objects, slot) for slot in slots], state)
        return clear_objects(state, empty, np.asarray(slots, int))

    def with_working_set(
        self, state: PlusState
    ) -> tuple[dict[int, Resting], dict[int, np.ndarray]]:
        """All objects of a memory of host arrays, at rest or not, and the partners of each."""
        objects = state.objects
        slots = np.flatnonzero(objects.id != NO_ID).tolist()
        present = [_copied(objects, slot) for slot in slots]
        of_present = {
            one.id: self._partners_of(objects, state.pairs, slot)
            for one, slot in zip(present, slots, strict=True)
        }
        everything = self._resting | {one.id: one for one in present}
        partners = {one: self.partners(one) for one in everything} | of_present
        return everything, partners

    def take_in(
        self, resting: Sequence[Resting], partners: Mapping[int, np.ndarray], state: PlusState
    ) -> None:
        """Adds objects that rested elsewhere, with whom each was seen; `state` is beside it."""
        self._put(resting, state)
        self._partners |= partners

    def wake(
        self, state: PlusState, ids: Iterable[int], center: Float[np.ndarray, "2"]
    ) -> PlusState:
        """Puts objects into free slots of a memory of host arrays; they rest until `drop_present`.

        Args:
          state: The memory, which has room for them.
          center: Of the frame, in frame units; somewhere around it they are.
        """
        whitener = Whitener.of(state.scene)
        objects = jax.tree.map(np.array, state.objects)
        pairs = jax.tree.map(np.array, state.pairs)
        free = iter(np.flatnonzero(objects.id == NO_ID).tolist())
        woken = []
        for object_id in ids:
            slot, one = next(free), self._resting[object_id]
            for name, value in one.values.items():
                getattr(objects, name)[slot] = value
            count = len(one.bank)
            objects.bank[slot, :count], objects.bank_count[slot, :count] = one.bank, one.bank_count
            objects.position[slot] = center
            pairs.covariance[slot, slot] = UNKNOWN_PLACE
            pairs.covisible[slot, slot] = one.values["seen"]
            woken.append(slot)
        kept = objects.bank_count[woken] > 0
        white = whitener.whiten(objects.bank[woken], objects.class_id[woken, None])
        objects.white_bank[woken] = np.where(kept[..., None], white, 0.0)
        slot_of = {int(one): slot for slot, one in enumerate(objects.id) if one != NO_ID}
        # Of two that meet again, only the one that rested first may know of the other.
        known = {slot: self.partners(one) for one, slot in slot_of.items()}
        partners = np.concatenate([*known.values()])
        slots = np.repeat([*known], [len(one) for one in known.values()])
        others = np.array([slot_of.get(one, NO_SLOT) for one in partners["id"].tolist()], int)
        meet = (others != NO_SLOT) & (np.isin(slots, woken) | np.isin(others, woken))
        _relate(pairs, slots[meet], others[meet], partners[meet])
        return dataclasses.replace(state, objects=objects, pairs=pairs)

    def drop_present(self, state: PlusState) -> None:
        """Lets go of objects at rest that are in the memory."""
        for object_id in {*np.asarray(state.objects.id).tolist()} & self._resting.keys():
            self._let_go(object_id)

    def forget(self, ids: Iterable[int]) -> None:
        """Lets objects go, at rest or not, with all that was known of them beside others."""
        gone = set(ids)
        for object_id in gone & self._resting.keys():
            self._let_go(object_id)
        for object_id in gone & self._partners.keys():
            del self._partners[object_id]

    def forget_least_known(self, num: int) -> list[int]:
        """Lets so many objects at rest go; gives their ids.

        First those that were seen in fewest frames, of these the earliest.
        """

        def worth(object_id: int) -> tuple[int, int]:
            values = self._resting[object_id].values
            return int(values["seen"]), int(values["last"])

        gone = sorted(self._resting, key=worth)[:num]
        self.forget(gone)
        return gone

    def snapshot(self) -> Snapshot:
        """What it holds now."""
        whitener = None if self._looks is None else self._looks.whitener
        return Snapshot(dict(self._resting), dict(self._partners), whitener)

    def tensors(self, since: Snapshot | None = None) -> dict[str, np.ndarray]:
        """What changed as arrays by name, for a file.

        Args:
          since: What the file has already; nothing if left out.
        """
        before = since or Snapshot()
        resting = [new for one, new in self._resting.items() if before.resting.get(one) is not new]
        partners = {
            one: new for one, new in self._partners.items() if before.partners.get(one) is not new
        }
        found = {
            "gone": _whole(before.resting.keys() - self._resting.keys()),
            "partners_gone": _whole(before.partners.keys() - self._partners.keys()),
        }
        found = {name: ids for name, ids in found.items() if len(ids)}
        if resting:
            found |= {name: np.stack([one.values[name] for one in resting]) for name in _COPIED}
            found["num_looks"] = _whole(len(one.bank) for one in resting)
            found["bank"] = np.concatenate([one.bank for one in resting])
            found["bank_count"] = np.concatenate([one.bank_count for one in resting])
        if partners:
            found["partners_of"] = _whole(partners)
            found["num_partners"] = _whole(len(one) for one in partners.values())
            values = np.concatenate([*partners.values()])
            found |= {f"partners.{name}": np.array(values[name]) for name in _PARTNER.names or ()}
        if self._looks is not None and self._looks.whitener is not before.whitener:
            found |= self._looks.tensors()
        return found

    def restore(
        self, parts: Sequence[Mapping[str, np.ndarray]], state: PlusState, num_classes: int
    ) -> None:
        """Goes on from what `tensors` gave.

        Args:
          parts: The first of everything, each other one of what changed since the one before.

        Raises:
          ValueError: If they do not belong together.
          KeyError: If one is missing.
        """
        resting, all_partners, looks = {}, {}, None
        for tensors in parts:
            holds_objects = not tensors.keys().isdisjoint(_COPIED)
            changed = _resting_of(tensors, state.objects) if holds_objects else {}
            for one in (*tensors.get("gone", _whole([])).tolist(), *changed):
                resting.pop(one, None)  # what rests anew comes last, as it did
            resting |= changed
            for one in tensors.get("partners_gone", _whole([])).tolist():
                all_partners.pop(one, None)
            if "partners_of" in tensors or changed:
                all_partners |= _partners_in(tensors)
            if any(name.startswith("whitener.") for name in tensors):
                looks = LookIndex.restored(tensors, Whitener.of(state.scene))
        _check(resting, state, num_classes)
        if looks is not None:  # earlier files lack it
            looks.add([one.owner for one in resting.values()])
        self._resting, self._partners, self._looks = resting, all_partners, looks

    def _put(self, resting: Sequence[Resting], state: PlusState) -> None:
        # In this order, and the other one where they go: what is found by its looks rests.
        looks = self.looks(state)
        self._resting |= {one.id: one for one in resting}
        looks.add([one.owner for one in resting])

    def _let_go(self, object_id: int) -> None:
        if self._looks is not None:
            self._looks.remove(self._resting[object_id].owner)
        del self._resting[object_id]

    def _partners_of(self, objects: Objects, pairs: Pairs, slot: int) -> np.ndarray:
        """Its nearest partners: as they are in the working set, and as they were before."""
        exists = objects.id != NO_ID
        known = (pairs.covisible[slot] > 0) | (pairs.spread[slot] < NO_RELATION)
        others = np.flatnonzero(exists & known)
        others = others[others != slot]
        now = np.zeros(len(others), _PARTNER)
        now["id"] = objects.id[others]
        for name in ("covisible", "relation", "spread", "log_ratio"):
            now[name] = getattr(pairs, name)[slot, others]
        before = self.partners(int(objects.id[slot]))
        before = before[~np.isin(before["id"], objects.id[exists])]
        both = np.concatenate([now, before])
        return both[np.argsort(-both["covisible"], kind="stable")[:MAX_PARTNERS]]


def _resting_of(tensors: Mapping[str, np.ndarray], blank: Objects) -> dict[int, Resting]:
    """Objects at rest by id, from arrays of a file that may be damaged."""
    num = len(tensors["id"])
    tensors = {"class_lead": tensors["seen"]} | dict(tensors)  # earlier files lack it
    for name in (*_COPIED, "bank", "bank_count"):
        leaf, own = getattr(blank, name), tensors[name]
        _require(own.dtype == leaf.dtype, f"'{name}' is of type {own.dtype}")
        expected = (num, *np.shape(leaf)[1:])
        _require(name not in _COPIED or own.shape == expected, f"'{name}' is of shape {own.shape}")
    num_looks, slots = tensors["num_looks"], np.shape(blank.bank)[1]
    _require(num_looks.shape == (num,), "'num_looks' is of another shape")
    _require(bool(np.all((num_looks >= 0) & (num_looks <= slots))), "too many looks of an object")
    looks = int(num_looks.sum())
    _require(tensors["bank"].shape == (looks, np.shape(blank.bank)[2]), "looks are missing")
    _require(tensors["bank_count"].shape == (looks,), "counts of looks are missing")
    _require(bool(np.all(tensors["bank_count"] > 0)), "a look was never seen")
    _require(len(np.unique(tensors["id"])) == num, "an id is there twice")
    starts = np.cumsum(num_looks)[:-1]
    kept = (np.split(tensors[name], starts) for name in ("bank", "bank_count"))
    found = [
        Resting({name: np.array(tensors[name][row]) for name in _COPIED}, *both)
        for row, both in enumerate(zip(*kept, strict=True))
    ]
    return {one.id: one for one in found}


def _partners_in(tensors: Mapping[str, np.ndarray]) -> dict[int, np.ndarray]:
    """Partners by id of the object, from arrays of a file that may be damaged."""
    num_partners = tensors["num_partners"]
    _require(num_partners.shape == tensors["partners_of"].shape, "partners are missing")
    within = (num_partners >= 0) & (num_partners <= MAX_PARTNERS)
    _require(bool(np.all(within)), "too many partners")
    partners = np.zeros(int(num_partners.sum()), _PARTNER)
    for name in _PARTNER.names or ():
        expected = (len(partners), *_PARTNER[name].shape)
        _require(tensors[f"partners.{name}"].shape == expected, "partners are missing")
        partners[name] = tensors[f"partners.{name}"]
    of_each = np.split(partners, np.cumsum(num_partners)[:-1])
    return dict(zip(tensors["partners_of"].tolist(), of_each, strict=True))


def _check(resting: Mapping[int, Resting], state: PlusState, num_classes: int) -> None:
    """Makes sure that objects can rest beside a memory."""
    ids, present = _whole(resting), np.asarray(state.objects.id)
    _require(not np.isin(ids, present).any(), "one is in the working set as well")
    _require(bool(np.all((ids >= 0) & (ids < int(state.next_id)))), "an id was never given")
    class_id = _whole(int(one.values["class_id"]) for one in resting.values())
    _require(bool(np.all((class_id >= 0) & (class_id < num_classes))), "a class has no name")


def _whole(values: Iterable[int]) -> Int[np.ndarray, "any"]:
    return np.fromiter(values, np.int32)


def _require(holds: bool, fault: str) -> None:
    if not holds:
        raise ValueError(fault)


def _copied(objects: Objects, slot: int) -> Resting:
    """An object of the working set, which may change afterwards."""
    num = int(np.count_nonzero(objects.bank_count[slot]))
    return Resting(
        {name: np.array(getattr(objects, name)[slot]) for name in _COPIED},
        np.array(objects.bank[slot, :num]),
        np.array(objects.bank_count[slot, :num]),
    )


def _relate(
    pairs: Pairs, slots: Int[np.ndarray, "P"], others: Int[np.ndarray, "P"], partners: np.ndarray
) -> None:
    """Writes what is known of objects and others, from either side: what more frames tell."""
    order = np.argsort(-partners["covisible"], kind="stable")
    both = np.sort([slots[order], others[order]], axis=0)
    best = order[np.unique(both, axis=1, return_index=True)[1]]
    slots, others, partners = slots[best], others[best], partners[best]
    for name, sign in (("covisible", 1), ("spread", 1), ("relation", -1), ("log_ratio", -1)):
        leaf = getattr(pairs, name)
        leaf[slots, others] = partners[name]
        leaf[others, slots] = sign * partners[name]
