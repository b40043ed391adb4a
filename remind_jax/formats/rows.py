"""Who is where, as a file or folder says it, whatever its format.

Letters: `N` rows, `T` frames, `M` regions to be ignored.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from hotcoco import mask as coco
from jaxtyping import Bool, Float, Int

from remind_jax.errors import SourceError
from remind_jax.frame import Rle
from remind_jax.masks.run_length import find_malformed

UNKNOWN_CLASS = -1


def _no_numbers() -> Int[np.ndarray, "0"]:
    return np.zeros(0, np.int64)


@dataclasses.dataclass(frozen=True)
class TrackRows:
    """Truth or predictions of one scene, ordered by frame."""

    name: str  # of the scene, for messages and tables
    num_frames: int
    frame: Int[np.ndarray, "N"]  # 0 ... num_frames - 1
    track_id: Int[np.ndarray, "N"]
    boxes: Float[np.ndarray, "N 4"]  # left, top, right, bottom in pixels; right, bottom excluded
    class_id: Int[np.ndarray, "N"]  # index into class_names, UNKNOWN_CLASS where unknown
    class_names: tuple[str, ...] = ()
    rles: tuple[Rle, ...] | None = None  # None where there are boxes only
    frame_names: tuple[str, ...] | None = None  # of the images, where the format knows them
    frame_size: tuple[int, int] | None = None  # height, width in pixels
    is_sampled: bool = False  # frames that are not listed were not looked at
    source_frames: Int[np.ndarray, "T"] | None = None  # numbers in the source, where it was sampled
    ignored_frame: Int[np.ndarray, "M"] = dataclasses.field(default_factory=_no_numbers)
    ignored_rles: tuple[Rle, ...] = ()  # regions in which nothing is known
    is_void: bool = False  # these are cut out of predictions pixel by pixel (DAVIS)
    # Number in text, see `formats.mot`.
    text_class: Int[np.ndarray, "N"] = dataclasses.field(default_factory=_no_numbers)
    first_frame: int = 0  # number of the first frame, for messages
    file: str = ""  # of text, for messages

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, keep: Bool[np.ndarray, "N"] | Int[np.ndarray, "M"]) -> TrackRows:
        """The same scene with only some of its rows, or with its rows in another order."""
        if keep.dtype == bool and keep.all():
            return self
        rows = np.arange(len(self))[keep]
        return dataclasses.replace(
            self,
            frame=self.frame[rows],
            track_id=self.track_id[rows],
            boxes=self.boxes[rows],
            class_id=self.class_id[rows],
            rles=None if self.rles is None else tuple(self.rles[row] for row in rows),
            text_class=self.text_class[rows] if len(self.text_class) else self.text_class,
        )


class RowCollector:
    """Gathers rows in any order; `finish` sorts and checks them."""

    def __init__(self) -> None:
        self._rows: list[tuple[int, int, int]] = []  # frame, id, class
        self._boxes: list[Any] = []  # may be empty where masks are
        self._rles: list[Rle] = []  # empty if no row has one

    def add(
        self,
        frame: int,
        track_id: int,
        class_id: int = UNKNOWN_CLASS,
        *,
        rle: Rle | None = None,
        box: Any = None,
    ) -> None:
        """Adds one row with a mask, or a box (left, top, right, bottom), or both."""
        self._rows.append((frame, track_id, class_id))
        if rle is not None:
            self._rles.append(rle)
        if box is not None:
            self._boxes.append(box)

    def finish(
        self,
        name: str,
        num_frames: int,
        *,
        class_names: Sequence[str] = (),
        frame_names: Sequence[str] | None = None,
        frame_size: tuple[int, int] | None = None,
    ) -> TrackRows:
        """The rows, ordered by frame.

        Raises:
          SourceError: If only some rows have a mask, or a mask is damaged.
        """
        rles, boxes, num = self._rles, self._boxes, len(self._rows)
        has_masks = len(rles) == num > 0
        if not has_masks and len(boxes) != num:
            raise SourceError(
                f"{name}: {len(rles)} of {num} rows have a mask and {len(boxes)} a box; all rows "
                "need the one or the other"
            )
        wrong = find_malformed(rles) if has_masks else None
        if wrong is not None:
            frame, track_id, _ = self._rows[wrong]
            raise SourceError(
                f"{name}, frame {frame}, id {track_id}: the run lengths are damaged or do not add "
                f"up to a mask of {' x '.join(map(str, rles[wrong]['size']))} pixels "
                "(height x width)"
            )
        frame, track_id, class_id = np.array(self._rows, np.int64).reshape(-1, 3).T
        rows = TrackRows(
            name=name,
            num_frames=num_frames,
            frame=frame,
            track_id=track_id,
            boxes=np.array(boxes, float).reshape(-1, 4) if len(boxes) == num else boxes_of(rles),
            class_id=class_id,
            class_names=tuple(class_names),
            rles=tuple(rles) if has_masks else None,
            frame_names=None if frame_names is None else tuple(frame_names),
        ).select(np.argsort(frame, kind="stable"))
        size = frame_size or (size_of(rows.rles[0]) if rows.rles else None)
        return dataclasses.replace(rows, frame_size=size)


def boxes_of(rles: Sequence[Rle]) -> Float[np.ndarray, "N 4"]:
    """Left, top, right, bottom of masks; right and bottom excluded."""
    if not rles:
        return np.zeros((0, 4))
    boxes = np.asarray(coco.toBbox(list(rles)), float).reshape(-1, 4)
    boxes[:, 2:] += boxes[:, :2]
    return boxes


def size_of(rle: Rle) -> tuple[int, int]:
    """Height and width of a mask."""
    height, width = rle["size"]
    return int(height), int(width)
