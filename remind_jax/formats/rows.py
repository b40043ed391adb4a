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


# Frame, id and class, with a mask, a box (left, top, right, bottom), or both.
Row = tuple[int, int, int, Rle | None, Any]


def collect_rows(name: str, num_frames: int, found: Sequence[Row], **known: Any) -> TrackRows:
    """Rows that were found in any order, ordered by frame; `known` are fields of `TrackRows`.

    Raises:
      SourceError: If only some rows have a mask, or a mask is damaged.
    """
    rles = tuple(rle for *_, rle, _ in found if rle is not None)
    boxes = [box for *_, box in found if box is not None]
    has_masks = len(rles) == len(found) > 0
    has_boxes = len(boxes) == len(found)
    if not has_masks and not has_boxes:
        raise SourceError(
            f"{name}: {len(rles)} of {len(found)} rows have a mask and {len(boxes)} a box; all "
            "rows need the one or the other"
        )
    wrong = find_malformed(rles) if has_masks else None
    if wrong is not None:
        frame, track_id, *_ = found[wrong]
        raise SourceError(
            f"{name}, frame {frame}, id {track_id}: the run lengths are damaged or do not add up "
            f"to a mask of {' x '.join(map(str, rles[wrong]['size']))} pixels (height x width)"
        )
    frame, track_id, class_id = np.array([row[:3] for row in found], np.int64).reshape(-1, 3).T
    rows = TrackRows(
        name=name,
        num_frames=num_frames,
        frame=frame,
        track_id=track_id,
        boxes=np.array(boxes, float).reshape(-1, 4) if has_boxes else boxes_of(rles),
        class_id=class_id,
        rles=rles if has_masks else None,
        **known,
    ).select(np.argsort(frame, kind="stable"))
    size = rows.frame_size or (size_of(rows.rles[0]) if rows.rles else None)
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
