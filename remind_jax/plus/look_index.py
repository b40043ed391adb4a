"""Looks of objects at rest, compared with those in view: every one of the class, exactly (host).

Rule: method_plus.md#recall.

Letters: `Q` looks that are asked for, `L` looks in a block, `D` feature dimension, `E` directions
that looks are compared in, `C` rows of classes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from remind_jax.numerics.absent import NO_ID
from remind_jax.plus.state import Scene
from remind_jax.plus.whitening import RESOLUTION

FIRST_BLOCK, MAX_BLOCK = 64, 1024  # looks in a block
MAX_GROWTH = 1.5  # looks are whitened anew when so many times as much was learned meanwhile


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
    learned: float  # looks that it was learned from

    @classmethod
    def of(cls, scene: Scene) -> Whitener:
        """That of a memory, which it outlives."""
        leaves = scene.whitener, scene.white_mean, scene.class_offset
        return cls(*map(np.array, leaves), learned=float(scene.within_weight))

    def whiten(
        self, looks: Float[np.ndarray, "*any D"], class_id: Int[np.ndarray, "*#any"] | int
    ) -> Float[np.ndarray, "*any E"]:
        """Looks of these classes as unit vectors; zeros for the mean of a class."""
        centered = looks - self.mean - self.class_offset[class_id % len(self.class_offset)]
        centered[np.sum(centered**2, axis=-1) <= RESOLUTION**2] = 0.0
        white = centered @ self.matrix.T
        return white / np.maximum(np.linalg.norm(white, axis=-1, keepdims=True), 1e-12)


class _Block:
    """Looks of a class side by side, whitened alike."""

    def __init__(self, class_id: int, size: int, whitener: Whitener) -> None:
        dim, white = whitener.matrix.shape[1], whitener.matrix.shape[0]
        self.owner = np.full(size, NO_ID, np.int32)  # object of each; NO_ID in free rows
        self.look = np.zeros((size, dim), np.float32)
        self.white = np.zeros((size, white), np.float32)
        self.class_id, self.whitener = class_id, whitener

    def renew(self, whitener: Whitener) -> None:
        """Whitens all of them anew."""
        if self.whitener is not whitener:
            self.whitener = whitener
            self.white = whitener.whiten(self.look, self.class_id)


class LookIndex:
    """Looks by class, in blocks, so that what is added or renewed at once stays little."""

    def __init__(self) -> None:
        """Empty."""
        self._blocks: dict[int, list[_Block]] = {}  # by class
        self._where: dict[int, list[_Block]] = {}  # of each object
        self._whitener: Whitener | None = None  # of new blocks, and of others by and by

    @property
    def class_ids(self) -> Collection[int]:
        """All classes that looks are or were of."""
        return self._blocks.keys()

    @property
    def bytes_of_look(self) -> int:
        """What one look takes here."""
        return 0 if self._whitener is None else 4 * (sum(self._whitener.matrix.shape) + 1)

    def add(self, owners: Sequence[Owner], whitener: Whitener) -> None:
        """Adds the looks of objects; `whitener` is how looks are whitened now."""
        whitener = self._follow(whitener)
        class_id = np.repeat([one.class_id for one in owners], [len(one.looks) for one in owners])
        white = whitener.whiten(np.concatenate([one.looks for one in owners]), class_id)
        start = 0
        for owner in owners:
            end = start + len(owner.looks)
            self._add(owner, white[start:end], whitener)
            start = end

    def remove(self, owner: int) -> None:
        """Lets the looks of an object go."""
        for block in self._where.pop(owner):
            block.owner[block.owner == owner] = NO_ID

    def search(
        self,
        looks: Float[np.ndarray, "Q D"],
        class_id: Int[np.ndarray, "Q"],
        whitener: Whitener,
        num: int,
    ) -> tuple[Int[np.ndarray, "Q num"], Float[np.ndarray, "Q num"]]:
        """The objects of the same class that look most alike, and cosines of their nearest looks.

        Args:
          looks: Asked for.
          class_id: Their classes.
          whitener: How looks are whitened now.
          num: Objects for each; NO_ID and -1 where there are fewer.
        """
        whitener = self._follow(whitener)
        best_owner = np.full((len(looks), num), NO_ID, np.int32)
        best = np.full((len(looks), num), -1.0, np.float32)
        whitened = {id(whitener): whitener.whiten(looks, class_id)}
        may_renew = True
        for one_class in np.unique(class_id).tolist():
            rows = np.flatnonzero(class_id == one_class)
            blocks, cosines = self._blocks.get(one_class, []), []
            for block in blocks:
                if may_renew and block.whitener is not whitener:
                    block.renew(whitener)
                    may_renew = len(block.owner) < MAX_BLOCK  # of large ones, one at a time
                key = id(block.whitener)
                if key not in whitened:
                    whitened[key] = block.whitener.whiten(looks, class_id)
                cosine = whitened[key][rows] @ block.white.T
                cosine[:, block.owner == NO_ID] = -1.0
                cosines.append(cosine)
            if blocks:
                best_owner[rows], best[rows] = self._first(blocks, cosines, num)
        return best_owner, best

    def _first(
        self, blocks: list[_Block], cosines: list[Float[np.ndarray, "Q _"]], num: int
    ) -> tuple[Int[np.ndarray, "Q num"], Float[np.ndarray, "Q num"]]:
        """The owners of the largest cosines, each once; whoever is found is taken out of these."""
        place_of = {id(block): place for place, block in enumerate(blocks)}
        largest = np.stack([cosine.max(axis=1) for cosine in cosines], axis=1)
        owners = np.full((len(largest), num), NO_ID, np.int32)
        best = np.full((len(largest), num), -1.0, np.float32)
        for row, of_row in enumerate(largest):
            for place in range(num):
                at = int(np.argmax(of_row))
                if of_row[at] <= -1.0:
                    break
                owner = blocks[at].owner[np.argmax(cosines[at][row])]
                owners[row, place], best[row, place] = owner, of_row[at]
                for block in self._where[int(owner)]:
                    there = place_of[id(block)]
                    cosines[there][row, block.owner == owner] = -1.0
                    of_row[there] = cosines[there][row].max()
        return owners, best

    def _follow(self, whitener: Whitener) -> Whitener:
        """The whitener to use: the one in use until much more was learned."""
        now = self._whitener
        if now is None or whitener.learned > MAX_GROWTH * max(now.learned, 1.0):
            now = self._whitener = whitener
        return now

    def _add(self, owner: Owner, white: Float[np.ndarray, "L E"], whitener: Whitener) -> None:
        blocks = self._blocks.setdefault(owner.class_id, [])
        places = self._where[owner.id] = []
        start, block = 0, blocks[-1] if blocks else None
        while start < len(white):
            free = [] if block is None else np.flatnonzero(block.owner == NO_ID)
            if block is None or not len(free):
                size = min(MAX_BLOCK, FIRST_BLOCK * 2 ** len(blocks))
                block = _Block(owner.class_id, size, whitener)
                blocks.append(block)
                continue
            block.renew(whitener)
            rows = free[: len(white) - start]
            end = start + len(rows)
            block.owner[rows] = owner.id
            block.look[rows], block.white[rows] = owner.looks[start:end], white[start:end]
            places.append(block)
            start = end
