"""Looks of objects at rest, compared with those in view: every one of the class, exactly (host).

Rule: method_plus.md#recall.

Letters: `Q` looks that are asked for, `L` looks, `D` feature dimension, `E` directions that looks
are compared in, `C` rows of classes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from remind_jax.numerics.absent import NO_ID
from remind_jax.plus.one_thread import on_one_thread
from remind_jax.plus.state import Scene
from remind_jax.plus.whitening import RESOLUTION

FIRST_PLACES = 64  # for looks of a class; doubled when they are taken
ADDED_AT_ONCE = 128  # objects: few enough for their looks to stay in the cache of a processor


class Owner(NamedTuple):
    """An object with its looks."""

    id: int
    class_id: int
    looks: Float[np.ndarray, "L D"]


@dataclasses.dataclass(frozen=True)
class Whitener:
    """How looks are whitened at some time, as `whitening.whiten` does."""

    matrix: Float[np.ndarray, "E D"]
    mean: Float[np.ndarray, "D"]
    class_offset: Float[np.ndarray, "C D"]  # by which looks of a class differ from it

    @classmethod
    def of(cls, scene: Scene) -> Whitener:
        """That of a memory, which it outlives."""
        return cls(*map(np.array, (scene.whitener, scene.white_mean, scene.class_offset)))

    @on_one_thread
    def whiten(
        self, looks: Float[np.ndarray, "*any D"], class_id: Int[np.ndarray, "*#any"] | int
    ) -> Float[np.ndarray, "*any E"]:
        """Looks of these classes as unit vectors; zeros for the mean of a class."""
        centered = looks - self.mean - self.class_offset[class_id % len(self.class_offset)]
        centered[np.sum(centered**2, axis=-1) <= RESOLUTION**2] = 0.0
        white = centered @ self.matrix.T
        return white / np.maximum(np.linalg.norm(white, axis=-1, keepdims=True), 1e-12)


class _Looks(NamedTuple):
    """Those of a class side by side."""

    owner: Int[np.ndarray, "L"]  # object of each; NO_ID in free places
    white: Float[np.ndarray, "L E"]

    def with_room_for(self, num: int) -> _Looks:
        """The same, with so many free places at least."""
        lacking = num - int(np.count_nonzero(self.owner == NO_ID))
        if lacking <= 0:
            return self
        added = (0, max(lacking, len(self.owner), FIRST_PLACES))
        owner = np.pad(self.owner, added, constant_values=NO_ID)
        return _Looks(owner, np.pad(self.white, (added, (0, 0))))


class LookIndex:
    """Looks by class, all whitened alike.

    Attributes:
      whitener: How they are.
      ticks: Of the memory, when it was taken from there.
    """

    def __init__(self, whitener: Whitener, ticks: int) -> None:
        """Empty."""
        self.whitener, self.ticks = whitener, ticks
        self._of_class: dict[int, _Looks] = {}

    @property
    def class_ids(self) -> Collection[int]:
        """All classes that looks are or were of."""
        return self._of_class.keys()

    @property
    def bytes_of_look(self) -> int:
        """What one look takes here."""
        return 4 * (len(self.whitener.matrix) + 1)

    def tensors(self) -> dict[str, np.ndarray]:
        """How looks are whitened, as arrays by name, for a file."""
        leaves = {f"whitener.{name}": leaf for name, leaf in vars(self.whitener).items()}
        return leaves | {"whitener.ticks": np.array([self.ticks], np.int32)}

    @classmethod
    def restored(cls, tensors: Mapping[str, np.ndarray], blank: Whitener) -> LookIndex:
        """What `tensors` gave, without any looks.

        Args:
          blank: One of the same shapes.

        Raises:
          ValueError: If it is none.
          KeyError: If an array is missing.
        """
        leaves = {name: tensors[f"whitener.{name}"] for name in vars(blank)}
        for name, leaf in leaves.items():
            fits = leaf.dtype == np.float32 and leaf.shape == np.shape(getattr(blank, name))
            if not fits:
                raise ValueError(f"'whitener.{name}' does not whiten these looks")
        return cls(Whitener(**leaves), tensors["whitener.ticks"].item())

    def add(self, owners: Sequence[Owner]) -> None:
        """Adds the looks of objects."""
        for start in range(0, len(owners), ADDED_AT_ONCE):
            self._add(owners[start : start + ADDED_AT_ONCE])

    def _add(self, owners: Sequence[Owner]) -> None:
        num_looks = [len(one.looks) for one in owners]
        owner = np.repeat(np.array([one.id for one in owners], np.int32), num_looks)
        class_id = np.repeat([one.class_id for one in owners], num_looks)
        white = self.whitener.whiten(np.concatenate([one.looks for one in owners]), class_id)
        for one_class in np.unique(class_id).tolist():
            rows = np.flatnonzero(class_id == one_class)
            before = self._of_class.get(one_class, _Looks(owner[:0], white[:0]))
            looks = self._of_class[one_class] = before.with_room_for(len(rows))
            places = np.flatnonzero(looks.owner == NO_ID)[: len(rows)]
            looks.owner[places], looks.white[places] = owner[rows], white[rows]

    def remove(self, owner: Owner) -> None:
        """Lets the looks of an object go."""
        if owner.class_id in self._of_class:  # it may have none
            places = self._of_class[owner.class_id].owner
            places[places == owner.id] = NO_ID

    @on_one_thread
    def search(
        self, looks: Float[np.ndarray, "Q D"], class_id: Int[np.ndarray, "Q"], num: int
    ) -> tuple[Int[np.ndarray, "Q num"], Float[np.ndarray, "Q num"]]:
        """The objects of the same class that look most alike, and cosines of their nearest looks.

        Args:
          num: Objects for each; NO_ID and -1 where there are fewer.
        """
        found = np.full((len(looks), num), NO_ID, np.int32)
        best = np.full((len(looks), num), -1.0, np.float32)
        asked = self.whitener.whiten(looks, class_id)
        for one_class in set(class_id.tolist()) & self._of_class.keys():
            owner, white = self._of_class[one_class]
            rows = np.flatnonzero(class_id == one_class)
            cosine = asked[rows] @ white.T
            cosine[:, owner == NO_ID] = -1.0
            for row, of_row in zip(rows, cosine, strict=True):
                for place in range(num):
                    at = int(np.argmax(of_row))
                    if of_row[at] <= -1.0:
                        break
                    found[row, place], best[row, place] = owner[at], of_row[at]
                    of_row[owner == owner[at]] = -1.0
        return found, best
