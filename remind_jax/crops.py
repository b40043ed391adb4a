"""Pixel masks of one picture, each kept within a box: for the many small ones of a crowded frame.

What the masks of one frame may be and take is said here, and compared before they are decoded.

Whole planes of 5,000 masks take 1.5 GB at 640x480 pixels; crops take what the masks cover.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Int

from remind_jax.errors import UnreadableFrame
from remind_jax.static import MOST_DETECTIONS

MOST_PLANES_BYTES = 1 << 26  # masks that would take more are kept as crops
MOST_MASK_BYTES = 1 << 29  # of the masks of one frame


@dataclasses.dataclass(frozen=True)
class Crops:
    """Booleans `[N, H, W]` as boxes; `numpy.asarray` makes planes of them."""

    size: tuple[int, int]  # height and width of the picture in pixels
    corners: tuple[tuple[int, int], ...]  # left and top of each box, in the picture
    windows: tuple[Bool[np.ndarray, "_h _w"], ...]  # what is in each box; nothing is outside

    @classmethod
    def of_planes(cls, planes: Iterable[Bool[np.ndarray, "H W"]], size: tuple[int, int]) -> Crops:
        """Cuts planes to the boxes around their masks, one after the other."""
        cut = [cut_plane(plane) for plane in planes]
        return cls(size, tuple(corner for corner, _ in cut), tuple(window for _, window in cut))

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
    def nbytes(self) -> int:
        """Memory that the masks take."""
        return sum(window.nbytes for window in self.windows)

    def __len__(self) -> int:
        return len(self.windows)

    def __iter__(self) -> Iterator[Bool[np.ndarray, "H W"]]:
        return (self.plane(row) for row in range(len(self)))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        planes = np.zeros(self.shape, bool)
        for plane, corner, window in zip(planes, self.corners, self.windows, strict=True):
            _within(plane, corner, window)[...] = window
        return planes if dtype is None else planes.astype(dtype)

    def __getitem__(self, rows: Any) -> Any:
        """One mask as a plane, or several as crops."""
        if np.ndim(rows) == 0 and not isinstance(rows, slice):
            return self.plane(int(rows))
        chosen = np.arange(len(self))[rows].tolist()
        corners = tuple(self.corners[row] for row in chosen)
        return Crops(self.size, corners, tuple(self.windows[row] for row in chosen))

    def sampled(self, from_row: Int[np.ndarray, "h"], from_column: Int[np.ndarray, "w"]) -> Crops:
        """Masks whose rows and columns are these rows and columns, both ascending."""
        corners, windows = [], []
        for (left, top), window in zip(self.corners, self.windows, strict=True):
            rows = slice(*np.searchsorted(from_row, [top, top + window.shape[0]]).tolist())
            columns = slice(*np.searchsorted(from_column, [left, left + window.shape[1]]).tolist())
            corners.append((columns.start, rows.start))
            windows.append(window[np.ix_(from_row[rows] - top, from_column[columns] - left)])
        return Crops((len(from_row), len(from_column)), tuple(corners), tuple(windows))

    def cropped(self, first_row: int, first_column: int, size: tuple[int, int]) -> Crops:
        """Masks of a part of the picture, of this height and width, that begins there."""
        if (first_row, first_column, size) == (0, 0, self.size):
            return self
        corners, windows = [], []
        for (left, top), window in zip(self.corners, self.windows, strict=True):
            # Where the part begins, counted from the box; below 0 if the box begins later.
            row, column = first_row - top, first_column - left
            corners.append((max(0, -column), max(0, -row)))
            windows.append(
                window[
                    max(0, row) : max(0, row + size[0]),
                    max(0, column) : max(0, column + size[1]),
                ]
            )
        return Crops(size, tuple(corners), tuple(windows))

    def plane(self, row: int) -> Bool[np.ndarray, "H W"]:
        """One mask over the whole picture."""
        plane = np.zeros(self.size, bool)
        _within(plane, self.corners[row], self.windows[row])[...] = self.windows[row]
        return plane

    def region(self, row: int, rows: slice, columns: slice) -> Bool[np.ndarray, "_h _w"]:
        """A part of a mask, which may reach beyond its box.

        Args:
          row: Of the mask.
          rows: From and to which row of the picture; both ends are given.
          columns: Likewise.
        """
        (left, top), window = self.corners[row], self.windows[row]
        height, width = window.shape
        first, last = max(top, rows.start), min(top + height, rows.stop)
        start, stop = max(left, columns.start), min(left + width, columns.stop)
        inside = window[
            first - top : max(first, last) - top, start - left : max(start, stop) - left
        ]
        if inside.shape == (rows.stop - rows.start, columns.stop - columns.start):
            return inside
        part = np.zeros((rows.stop - rows.start, columns.stop - columns.start), bool)
        if inside.size:
            _within(part, (start - columns.start, first - rows.start), inside)[...] = inside
        return part


def require_few(num: int, name: str, most: int = MOST_DETECTIONS) -> None:
    """Compares the detections of a frame with how many there may be.

    Args:
      num: Detections.
      name: What has them, for the message.
      most: A tracker may take fewer.

    Raises:
      UnreadableFrame: If there are more.
    """
    if num > most:
        more = (
            "" if most == MOST_DETECTIONS else f", or room for more (static.num_detections={num})"
        )
        raise UnreadableFrame(
            f"{name} has {num} detections, at most {most} are taken in a frame; give the best ones "
            f"or the wanted classes only{more}"
        )


def require_bytes(num_bytes: int, num: int, frame_size: Sequence[int], name: str) -> None:
    """Compares the memory for the masks of a frame with what is meant for them.

    Args:
      num_bytes: Of the boxes around the masks, a byte to a pixel.
      num: Masks.
      frame_size: Height and width of the frame in pixels.
      name: What has them, for the message.

    Raises:
      UnreadableFrame: If it is more.
    """
    if num_bytes > MOST_MASK_BYTES:
        raise UnreadableFrame(
            f"{name} has {num} detections in {frame_size[1]}x{frame_size[0]} pixels, whose boxes "
            f"take {num_bytes >> 20} MiB; at most {MOST_MASK_BYTES >> 20} are meant for a frame, "
            "give fewer or smaller ones"
        )


def count_pixels(masks: Bool[np.ndarray, "N H W"] | Crops) -> Int[np.ndarray, "N"]:
    """Pixels of each mask."""
    if isinstance(masks, Crops):
        return np.array([np.count_nonzero(window) for window in masks.windows], np.int64)
    return masks.sum(axis=(1, 2))


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
      height: Pixels of a column.
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


def cut_plane(
    plane: Bool[np.ndarray, "H W"],
) -> tuple[tuple[int, int], Bool[np.ndarray, "_h _w"]]:
    """Left and top of the box around a mask, and a copy of what is in it."""
    rows = np.flatnonzero(plane.any(axis=1))
    if not len(rows):
        return (0, 0), np.zeros((0, 0), bool)
    band = plane[rows[0] : rows[-1] + 1]
    columns = np.flatnonzero(band.any(axis=0))
    corner = int(columns[0]), int(rows[0])
    return corner, band[:, columns[0] : columns[-1] + 1].copy()


def _within(
    plane: Bool[np.ndarray, "H W"], corner: tuple[int, int], window: np.ndarray
) -> Bool[np.ndarray, "_h _w"]:
    """The part of a plane where a window lies."""
    left, top = corner
    return plane[top : top + window.shape[0], left : left + window.shape[1]]
