"""Pixel masks of one picture, each cut to the box around it: what is measured of them lies there.

What the masks of one frame may be and take is said here, and compared before they are decoded.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Int

from remind_jax.errors import UnreadableFrame
from remind_jax.files.limits import MAX_MASK_BYTES
from remind_jax.static import MOST_DETECTIONS


@dataclasses.dataclass(frozen=True)
class Crops:
    """Booleans `[N, H, W]` as boxes; `numpy.asarray` makes planes of them."""

    size: tuple[int, int]  # height and width of the picture in pixels
    corners: tuple[tuple[int, int], ...]  # left and top of each box, in the picture
    windows: tuple[Bool[np.ndarray, "_h _w"], ...]  # what is in each box; nothing is outside

    @classmethod
    def of(cls, masks: Bool[np.ndarray, "N H W"] | Crops) -> Crops:
        """Cuts planes to the boxes around their masks; crops stay as they are."""
        if isinstance(masks, Crops):
            return masks
        return cls.join((masks.shape[1], masks.shape[2]), map(cut_plane, masks))

    @classmethod
    def join(
        cls, size: tuple[int, int], cut: Iterable[tuple[tuple[int, int], np.ndarray]]
    ) -> Crops:
        """Masks of which corner and window are given."""
        pairs = list(cut)
        return cls(size, tuple(c for c, _ in pairs), tuple(window for _, window in pairs))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Masks, height, width."""
        return len(self.windows), *self.size

    @property
    def dtype(self) -> np.dtype[Any]:
        """That of the planes."""
        return np.dtype(bool)

    @property
    def ndim(self) -> int:
        """That of the planes."""
        return 3

    @property
    def areas(self) -> Int[np.ndarray, "N"]:
        """Pixels of each mask."""
        return np.array([np.count_nonzero(window) for window in self.windows], np.int64)

    def __len__(self) -> int:
        return len(self.windows)

    def __iter__(self) -> Iterator[Bool[np.ndarray, "H W"]]:
        return (self[row] for row in range(len(self)))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        planes = np.zeros(self.shape, bool)
        for plane, (left, top), window in zip(planes, self.corners, self.windows, strict=True):
            plane[top : top + window.shape[0], left : left + window.shape[1]] = window
        return planes if dtype is None else planes.astype(dtype)

    def __getitem__(self, rows: Any) -> Any:
        """One mask as a plane, or several as crops."""
        if np.ndim(rows) == 0 and not isinstance(rows, slice):
            return np.asarray(self[[rows]])[0]
        chosen = np.arange(len(self))[rows].tolist()
        return self.join(self.size, ((self.corners[row], self.windows[row]) for row in chosen))

    def box(self, row: int) -> Sequence[int]:
        """Left, top, width and height of the box around a mask; no width if it is empty."""
        window, (left, top) = self.windows[row], self.corners[row]
        if not window.size:
            return 0, 0, 0, 0
        box = cv2.boundingRect(np.ascontiguousarray(window).view(np.uint8))
        return (box[0] + left, box[1] + top, box[2], box[3]) if box[2] else (0, 0, 0, 0)

    def sampled(self, from_row: Int[np.ndarray, "h"], from_column: Int[np.ndarray, "w"]) -> Crops:
        """Masks whose rows and columns are these rows and columns, both ascending."""
        cut = []
        for (left, top), window in zip(self.corners, self.windows, strict=True):
            rows = slice(*np.searchsorted(from_row, [top, top + window.shape[0]]).tolist())
            columns = slice(*np.searchsorted(from_column, [left, left + window.shape[1]]).tolist())
            inside = window[np.ix_(from_row[rows] - top, from_column[columns] - left)]
            cut.append(((columns.start, rows.start), inside))
        return self.join((len(from_row), len(from_column)), cut)

    def eroded(self, radius_px: int, *, margin_px: int) -> Crops:
        """Erodes every mask once with a square of `2 * radius_px + 1` pixels.

        Args:
          radius_px: Pixels that a mask loses on every side; 0 leaves the masks as they are.
          margin_px: What lies farther outside the box around a mask, or outside the image, counts
            as inside the mask: with the radius as margin, only the border of the image does not
            erode, with 0 the sides of the box do not either.
        """
        if radius_px <= 0:
            return self
        kernel = np.ones((2 * radius_px + 1,) * 2, np.uint8)
        eroded = []
        for row in range(len(self)):
            left, top, width, height = self.box(row)
            if not width:
                eroded.append(((0, 0), np.zeros((0, 0), bool)))
                continue
            rows = slice(max(0, top - margin_px), min(self.size[0], top + height + margin_px))
            columns = slice(max(0, left - margin_px), min(self.size[1], left + width + margin_px))
            window = self.region(row, rows, columns).view(np.uint8)
            eroded.append(((columns.start, rows.start), cv2.erode(window, kernel).view(bool)))
        return self.join(self.size, eroded)

    def region(self, row: int, rows: slice, columns: slice) -> Bool[np.ndarray, "_h _w"]:
        """A part of a mask, which may reach beyond its box; contiguous. Slices have both ends."""
        (left, top), window = self.corners[row], self.windows[row]
        height, width = window.shape
        first, last = max(top, rows.start), min(top + height, rows.stop)
        start, stop = max(left, columns.start), min(left + width, columns.stop)
        last, stop = max(first, last), max(start, stop)
        inside = window[first - top : last - top, start - left : stop - left]
        if inside.shape == (rows.stop - rows.start, columns.stop - columns.start):
            return np.ascontiguousarray(inside)
        part = np.zeros((rows.stop - rows.start, columns.stop - columns.start), bool)
        if inside.size:
            across = slice(start - columns.start, stop - columns.start)
            part[first - rows.start : last - rows.start, across] = inside
        return part


def require_room(
    num: int, frame_size: Sequence[int], name: str, most: int = MOST_DETECTIONS
) -> None:
    """Compares the detections of a frame with how many there may be, and the memory of their masks.

    Raises:
      UnreadableFrame: If there are more.
    """
    if num > most:
        is_chosen = most != MOST_DETECTIONS
        more = f", or room for more (static.num_detections={num})" if is_chosen else ""
        raise UnreadableFrame(
            f"{name} has {num} detections, at most {most} are taken in a frame; give the best ones "
            f"or the wanted classes only{more}"
        )
    height, width = frame_size
    if num * height * width > MAX_MASK_BYTES:
        raise UnreadableFrame(
            f"{name} has {num} detections in {width}x{height} pixels, whose masks take "
            f"{num * height * width >> 20} MiB; at most {MAX_MASK_BYTES >> 20} are meant for a "
            "frame, give fewer of them or smaller frames"
        )


def nearest_places(num: int, num_resized: int) -> Int[np.ndarray, "r"]:
    """Which of `num` rows or columns each one of a resized picture is, by nearest neighbor."""
    places = np.arange(num, dtype=np.int32)[None]
    if num == num_resized:
        return places[0]
    return cv2.resize(places, (num_resized, 1), interpolation=cv2.INTER_NEAREST)[0]


def cut_runs(
    runs: Int[np.ndarray, "_"], height: int
) -> tuple[tuple[int, int], Bool[np.ndarray, "_h _w"]]:
    """As `cut_plane`, of a mask by its run lengths: what the rest of the picture takes is nothing.

    Args:
      runs: Pixels of background, of mask, of background, ... column after column.
    """
    edges = np.cumsum(runs)
    num = len(runs) // 2
    starts, stops = edges[0 : 2 * num : 2], edges[1 : 2 * num : 2]
    is_some = stops > starts
    starts, stops = starts[is_some], stops[is_some]
    if not len(starts):
        return (0, 0), np.zeros((0, 0), bool)
    # Runs are cut where columns end.
    first, last = starts // height, (stops - 1) // height
    pieces = last - first + 1
    run = np.repeat(np.arange(len(starts)), pieces)
    column = first[run] + np.arange(len(run)) - (np.cumsum(pieces) - pieces)[run]
    begin = np.maximum(starts[run] - column * height, 0)
    end = np.minimum(stops[run] - column * height, height)
    left, top = int(first[0]), int(begin.min())
    change = np.zeros((int(last[-1]) - left + 1, int(end.max()) - top + 1), np.int8)
    change[column - left, begin - top] += 1
    change[column - left, end - top] -= 1
    inside = np.cumsum(change[:, :-1], axis=1, dtype=np.int8)
    return (left, top), np.ascontiguousarray(inside.T).view(bool)


def cut_plane(plane: Bool[np.ndarray, "H W"]) -> tuple[tuple[int, int], Bool[np.ndarray, "_h _w"]]:
    """Left and top of the box around a mask, and a copy of what is in it."""
    rows = np.flatnonzero(plane.any(axis=1))
    if not len(rows):
        return (0, 0), np.zeros((0, 0), bool)
    band = plane[rows[0] : rows[-1] + 1]
    columns = np.flatnonzero(band.any(axis=0))
    corner = int(columns[0]), int(rows[0])
    return corner, band[:, columns[0] : columns[-1] + 1].copy()
