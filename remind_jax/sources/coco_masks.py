"""Detections in files, as COCO run-length codes.

Recognized:
    a COCO results list: [{"image_id", "category_id", "segmentation", "score"}, ...]
    a COCO data set: {"images": [...], "annotations": [...], "categories": [...]}
    a COCO video (YouTube-VIS): annotations with "segmentations", one per frame, null where unseen
    frames: [{"frame": 12, "detections": [...]}, ...], also one per line (.jsonl); "name" of the
        image file may stand in for the number
A detection has "segmentation" (run-length code, or polygons) or else "bbox" (left, top, width,
height), which is filled; "score"; "label", or "category_id" and categories to name it by.

An image of a COCO file belongs to the frame with the stem of its `file_name`; without that, to the
frame whose name has its `image_id` as number; in a video, to the frame of that number. The entries
of "segmentations" belong to the frames at the same place, or to the `file_names` of their video.

Rows that are damaged are left out, counted and told in `notes`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

import msgspec
import numpy as np

from remind_jax.crops import MOST_PLANES_BYTES, Crops, require_bytes, require_few
from remind_jax.errors import SourceError
from remind_jax.files.records import Whole, decode_json
from remind_jax.frame import Detections
from remind_jax.sources.class_names import ANY_CLASS
from remind_jax.sources.coco_rows import (
    Category,
    FoundRows,
    Name,
    Place,
    Position,
    Row,
    name_categories,
)
from remind_jax.sources.detections import crops_of_boxes, name_classes
from remind_jax.sources.file_tree import last_number
from remind_jax.sources.label_maps import fit_crops
from remind_jax.sources.segmentations import cut_sound
from remind_jax.sources.source import Entry, Reader


class CocoMasks:
    """Detections of a sequence from a file.

    Args:
      data: Content of the file, JSON or JSON lines.
      file: Its name for messages.
      reader: The frames that they belong to.
      categories: Name per category id, where the file has none.

    Raises:
      SourceError: If the file is of no known form, belongs to other frames, has unnamed
        categories, or not one good row.
    """

    def __init__(
        self,
        data: bytes,
        file: str,
        reader: Reader,
        categories: Mapping[int, str] | None = None,
    ) -> None:
        found = FoundRows(data, file)
        self._file, self._num_rows = file, found.num_rows
        self._num_bad, self._first_bad = found.num_bad, str(found.first_bad)
        self._categories = found.categories or dict(categories or {})
        self._rows = _match_places(found.by_place, reader)
        if found.by_place and not self._rows:
            frames = reader.entry_names
            raise SourceError(
                f"no detection in '{file}' belongs to a frame of '{reader.name}' (first in the "
                f"file: '{next(iter(found.by_place))}', first frame: "
                f"'{frames[0] if frames else 0}')"
            )
        self.frames = self._rows.keys()
        self.notes: list[str] = []
        if len(self._rows) < len(found.by_place):
            self.notes.append(
                f"{len(found.by_place) - len(self._rows)} of {len(found.by_place)} images in "
                f"'{file}' are not frames of '{reader.name}'"
            )
        self._bad_note = len(self.notes)
        self._tell_bad()
        self._unfit: set[tuple[int, int]] = set()  # frame and row of masks of another picture
        self._require_names()

    def detections_of(self, entry: Entry, frame_size: tuple[int, int]) -> Detections:
        """Detections of one frame, in the order of the file.

        Raises:
          UnreadableFrame: If there are too many, or more than memory is meant for.
          SourceError: If none of their masks can be of this picture.
        """
        rows = self._rows.get(entry.source_index, [])
        where, num_bytes = f"'{self._file}'", 0
        require_few(len(rows), where)
        cut: list[Crops] = []
        kept: list[int] = []
        unfit: SourceError | None = None
        for place, row in enumerate(rows):
            try:
                crop = self._cut(row, frame_size)
            except SourceError as error:
                unfit = error
                self._leave_out(entry.source_index, place, error)
                continue
            fitted = fit_crops(crop, frame_size)
            num_bytes += max(crop.nbytes, fitted.nbytes)
            require_bytes(num_bytes, len(rows), frame_size, where)
            cut.append(fitted)
            kept.append(place)
        if unfit is not None and not kept:
            raise unfit
        chosen = [rows[place] for place in kept]
        crops = Crops(
            frame_size,
            tuple(crop.corners[0] for crop in cut),
            tuple(crop.windows[0] for crop in cut),
        )
        is_large = len(kept) * frame_size[0] * frame_size[1] > MOST_PLANES_BYTES
        return Detections.create(
            crops if is_large else np.asarray(crops),
            [self._name(row) for row in chosen],
            [row.score for row in chosen],
            [row.instance_id for row in chosen],
        )

    def _cut(self, row: Row, frame_size: tuple[int, int]) -> Crops:
        if row.segmentation:
            return cut_sound(row.segmentation, frame_size)
        assert row.bbox is not None
        left, top, width, height = row.bbox
        box = np.array([[left, top, left + width, top + height]])
        return crops_of_boxes(box, frame_size)

    def _name(self, row: Row) -> str:
        if row.label is not None:
            return row.label
        if row.category_id is None:
            return ANY_CLASS
        return name_classes([row.category_id], self._categories or None)[0]

    def _leave_out(self, frame: int, place: int, error: SourceError) -> None:
        if (frame, place) not in self._unfit:  # sources are iterated more than once
            self._unfit.add((frame, place))
            self._num_bad += 1
            if self._num_bad == 1:
                self._first_bad = f"'{self._file}', a detection of frame {frame}: {error}"
            self._tell_bad()

    def _tell_bad(self) -> None:
        if self._num_bad:
            self.notes[self._bad_note :] = [
                f"{self._num_bad} of {self._num_rows} detections are left out, the first: "
                f"{self._first_bad}"
            ]

    def _require_names(self) -> None:
        """Names every category without a name before work starts."""
        if not self._categories:
            return
        used = {
            row.category_id
            for rows in self._rows.values()
            for row in rows
            if row.category_id is not None and row.label is None
        }
        missing = sorted(used - set(self._categories))
        if missing:
            raise SourceError(
                f"categories {', '.join(map(str, missing[:20]))} in '{self._file}' have no name; "
                "add them to its 'categories' or give a file of categories as metadata"
            )


def read_categories(data: bytes, file: str) -> dict[int, str]:
    """Category names: `{"categories": [{"id", "name"}]}`, `{"0": "cup"}`, or a list of names.

    Raises:
      SourceError: If it is something else.
    """
    if data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"[":
        listed = decode_json(data, list[Name | _Named], f"'{file}'")
        return {i: c if isinstance(c, str) else c.name for i, c in enumerate(listed)}
    parts = decode_json(data, dict[str, msgspec.Raw], f"'{file}'")
    if "categories" in parts:
        return name_categories(decode_json(data, _Categories, f"'{file}'").categories, file)
    try:
        return decode_json(data, dict[Whole, Name], f"'{file}'")
    except SourceError as error:
        raise SourceError(
            f'\'{file}\' names no categories; give {{"categories": [{{"id": 1, "name": "cup"}}]}}'
        ) from error


class _Named(msgspec.Struct, frozen=True):
    name: Name


class _Categories(msgspec.Struct, frozen=True):
    categories: list[Category]


def _match_places(by_place: Mapping[Place, list[Row]], reader: Reader) -> dict[int, list[Row]]:
    """Detections by source frame."""
    names = reader.entry_names or ()
    index_of: dict[Any, int] = {PurePosixPath(name).stem: i for i, name in enumerate(names)}
    for i, name in enumerate(names):
        number = last_number(name)
        index_of.setdefault(i if number is None else number, i)
    rows: dict[int, list[Row]] = defaultdict(list)
    for place, found in by_place.items():
        if isinstance(place, Position):
            index: int | None = place.index
        elif reader.entry_names is None:
            index = last_number(place) if isinstance(place, str) else place
        else:
            index = index_of.get(PurePosixPath(place).stem if isinstance(place, str) else place)
        if index is not None:
            rows[index].extend(found)
    return dict(rows)
