"""Small pictures of remembered objects: the best view of each visit, and of those the best three.

Judging a view takes longer than the rest of keeping records, so it is done at the first, second,
fourth, eighth ... frame of a visit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import UInt8

from remind_jax.outputs.drawing import encode_jpeg
from remind_jax.outputs.gallery import CLEARLY_BETTER, crop_detection, view_quality
from remind_jax.tracks import Tracks

MAX_PICTURES = 3  # of an object
PICTURE_PX = 96  # side
MAX_FILE_BYTES = 8 << 20  # of all pictures in a memory file
_JPEG_QUALITY = 82


@dataclasses.dataclass(frozen=True)
class Picture:
    """One view of an object."""

    quality: float  # `gallery.view_quality`, comparable between views of one object
    jpeg: bytes  # `PICTURE_PX` squared, the object outlined


@dataclasses.dataclass(frozen=True)
class Pictures:
    """The views of one object that are kept."""

    earlier: tuple[Picture, ...] = ()  # of earlier visits, best first
    now: Picture | None = None  # of the visit that lasts
    num_frames: int = 0  # of that visit

    @property
    def best(self) -> tuple[Picture, ...]:
        """All of them, best first."""
        now = () if self.now is None else (self.now,)
        return best_of((*self.earlier, *now))

    def place_of_now(self, kept: Sequence[Picture]) -> int:
        """Which of some pictures is that of the visit that lasts; -1 if none is."""
        places = (place for place, picture in enumerate(kept) if picture is self.now)
        return next(places, -1)

    def next_visit(self) -> Pictures:
        """Before the first frame of a visit."""
        return Pictures(self.best)

    def look(self, image: UInt8[np.ndarray, "H W 3"], tracks: Tracks, row: int) -> Pictures:
        """After one more frame of the visit, in which the object is a detection of `tracks`."""
        num_frames = self.num_frames + 1
        now = self.now
        if num_frames & (num_frames - 1) == 0:
            quality = view_quality(image, tracks, row)
            if now is None or quality > CLEARLY_BETTER * now.quality:
                crop = crop_detection(image, tracks, row, PICTURE_PX)
                now = Picture(quality, encode_jpeg(crop, _JPEG_QUALITY))
        return Pictures(self.earlier, now, num_frames)


def best_of(pictures: Iterable[Picture]) -> tuple[Picture, ...]:
    """The best ones, best first; of equals those that come first."""
    return tuple(sorted(pictures, key=lambda one: -one.quality)[:MAX_PICTURES])


def fit_into(budget: int, pictures: Sequence[Sequence[Picture]]) -> list[tuple[Picture, ...]]:
    """As many pictures as a number of bytes allows: first the best of each object, then the next.

    Those of each object are given best first; the first object comes first.
    """
    kept: list[list[Picture]] = [[] for _ in pictures]
    for place in range(MAX_PICTURES):
        for own, given in zip(kept, pictures, strict=True):
            if len(own) == place < len(given) and len(given[place].jpeg) <= budget:
                own.append(given[place])
                budget -= len(given[place].jpeg)
    return [tuple(own) for own in kept]
