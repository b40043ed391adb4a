"""MOTChallenge text (boxes), MOTS and KITTI-MOTS text (masks), and TrackEval's rules for them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from remind_jax import files
from remind_jax.errors import SourceError
from remind_jax.files.limits import MAX_FRAMES, MAX_SIDE_PX, MAX_TEXT_BYTES
from remind_jax.formats.firm import (
    firm_ids,
    firm_rows,
    main_labels,
    masks_without_overlap,
    stated_confidence,
)
from remind_jax.formats.rows import UNKNOWN_CLASS, Row, TrackRows, collect_rows
from remind_jax.frame import Rle
from remind_jax.masks.run_length import mask_areas, union_area
from remind_jax.tracks import Tracks

FileFormat = Literal["mot", "mots", "kitti-mots"]

MOTS_CLASSES = {1: "car", 2: "pedestrian"}
MOTS_IGNORE_CLASS = 10
DEFAULT_MOTS_CLASS = 2
_MOTS_CAR = 1

_MAX_NUMBER = 1e16
_MAX_ID = 2**63 - 1

# Whole numbers up to here are exact as floats.
_MAX_WHOLE = 2.0**53


def recognize_format(*paths: str | Path) -> FileFormat:
    """Tells MOTChallenge text from MOTS text by the first row of the first file that has one.

    MOTS counts from 0 where any file has a frame 0, as others may begin without an object.

    Raises:
      SourceError: If that row fits neither.
    """
    for path in paths:
        lines = _read_text(path).splitlines()
        first = next((line for line in lines if line.strip()), None)
        if first is None:
            continue
        if "," not in first and len(first.split()) == 6:
            frames = (row.split(" ", 1)[0] for one in paths for row in _read_text(one).splitlines())
            return "kitti-mots" if "0" in frames else "mots"
        if len(first.split("," if "," in first else None)) < 6:
            raise SourceError(
                f"{path} is neither MOTChallenge text (frame,id,left,top,width,height,...) "
                f"nor MOTS text (frame id class height width rle); its first row is '{first[:60]}'"
            )
        return "mot"
    return "mot"


def read_text_rows(path: str | Path, name: str, format: FileFormat, *, is_truth: bool) -> TrackRows:
    """Reads one file, which may be empty.

    In truth, flag 0 means "to be ignored" (MOT) and class 10 is an ignore region (MOTS).

    Raises:
      SourceError: If it cannot be read or breaks the rules of its format.
    """
    if format == "mot":
        return _read_boxes(path, name, is_truth=is_truth)
    return _read_masks(path, name, 0 if format == "kitti-mots" else 1, is_truth=is_truth)


def fit_texts(
    truth: TrackRows,
    prediction: TrackRows,
    *,
    num_frames: int | None = None,
    class_id: int | None = None,
) -> tuple[TrackRows, TrackRows]:
    """Two files of one format as TrackEval compares them: of one length and one class.

    The length is that up to the last row of either side, if it is not given. The class is that to
    keep, in MOT of the truth (all if left out), in MOTS of both sides (2, pedestrian, if left out).

    Raises:
      SourceError: If a row lies beyond the length, masks of one frame overlap, or all rows are of
        other classes.
    """
    length = max(truth.num_frames, prediction.num_frames) if num_frames is None else num_frames
    for rows in (truth, prediction):
        if rows.num_frames > length:
            last = rows.num_frames - 1 + rows.first_frame
            frames = _say_frames(rows.first_frame, length)
            raise SourceError(f"{rows.file} has a row of frame {last}; {frames}")
        if rows.rles is not None:
            _check_overlaps(rows)
    truth, prediction = (
        dataclasses.replace(rows, num_frames=length) for rows in (truth, prediction)
    )
    if truth.rles is None:
        return _name_classes(truth, class_id), prediction
    if class_id is None:  # which nobody asked for: both sides must be about it
        class_id = DEFAULT_MOTS_CLASS
        _require_class(class_id, truth)
        _require_class(class_id, prediction)
    _require_class(class_id, truth, prediction)
    truth, prediction = (_keep_class(rows, class_id) for rows in (truth, prediction))
    frame_size = truth.frame_size or prediction.frame_size or (1, 1)  # any, if there is no row
    return dataclasses.replace(truth, frame_size=frame_size), prediction


def _read_boxes(path: str | Path, name: str, *, is_truth: bool) -> TrackRows:
    table = _read_numbers(path)
    table = table[np.argsort(table[:, 0], kind="stable")]
    frame, track_id = table[:, :2].astype(np.int64).T
    frame, num_frames = _count_frames(path, frame, 1)
    boxes = table[:, 2:6].copy()
    boxes[:, 2:] += boxes[:, :2]
    num_columns = table.shape[1]
    unknown = np.full(len(frame), UNKNOWN_CLASS)
    text_class = np.maximum(unknown, table[:, 7].astype(np.int64)) if num_columns > 7 else unknown
    rows = TrackRows(
        name=name,
        num_frames=num_frames,
        frame=frame,
        track_id=track_id,
        boxes=boxes,
        class_id=unknown,
        text_class=text_class,
        first_frame=1,
        file=str(path),
    )
    return rows.select(table[:, 6] != 0) if is_truth and num_columns > 6 else rows


def _read_masks(path: str | Path, name: str, first_frame: int, *, is_truth: bool) -> TrackRows:
    found: list[Row] = []
    for line_number, line in enumerate(_read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        try:
            frame, track_id, class_id, height, width, counts = line.split()
            row = int(frame), int(track_id), int(class_id)
            size = [int(height), int(width)]
            if max(map(abs, row)) > _MAX_ID or not 1 <= min(size) <= max(size) <= MAX_SIDE_PX:
                raise ValueError("beyond all measure")
            found.append((*row, {"size": size, "counts": counts.encode("ascii")}, None))
        except ValueError:
            raise SourceError(
                f"{path}, line {line_number}: '{line[:60]}' is not a MOTS row; "
                "it needs frame id class height width rle, separated by spaces, whole numbers and "
                f"sides of 1 to {MAX_SIDE_PX} pixels"
            ) from None
    rows = collect_rows(str(path), 0, found)
    frame, num_frames = _count_frames(path, rows.frame, first_frame)
    rows = dataclasses.replace(
        rows,
        name=name,
        num_frames=num_frames,
        frame=frame,
        class_id=np.full(len(frame), UNKNOWN_CLASS),
        text_class=rows.class_id,
        rles=rows.rles or (),
        first_frame=first_frame,
        file=str(path),
    )
    if not is_truth:
        return rows
    is_ignored = rows.text_class == MOTS_IGNORE_CLASS
    ignored = rows.select(is_ignored)
    return dataclasses.replace(
        rows.select(~is_ignored), ignored_frame=ignored.frame, ignored_rles=ignored.rles
    )


def _count_frames(
    path: str | Path, frame: Int[np.ndarray, "N"], first: int
) -> tuple[Int[np.ndarray, "N"], int]:
    """Frames counted from 0, and the number of frames up to the last row."""
    if len(frame) and not first <= frame[0] <= frame[-1] < first + MAX_FRAMES:
        wrong = frame[0] if frame[0] < first else frame[-1]
        raise SourceError(f"{path} has a row of frame {wrong}; {_say_frames(first, MAX_FRAMES)}")
    frame = frame - first
    return frame, int(frame.max(initial=-1)) + 1


def _say_frames(first: int, num_frames: int) -> str:
    return f"frames are numbered {first} to {first + num_frames - 1}"


def _name_classes(boxes: TrackRows, class_id: int | None) -> TrackRows:
    """Boxes of one class or of all, classes named by their numbers if every box has one."""
    if class_id is not None:
        _require_class(class_id, boxes)
        boxes = boxes.select(boxes.text_class == class_id)
    numbers, place = np.unique(boxes.text_class, return_inverse=True)
    if UNKNOWN_CLASS in numbers:
        return boxes
    names = tuple(f"class {number}" for number in numbers)
    return dataclasses.replace(boxes, class_id=place, class_names=names)


def _keep_class(masks: TrackRows, class_id: int) -> TrackRows:
    kept = masks.select(masks.text_class == class_id)
    name = MOTS_CLASSES.get(class_id, f"class {class_id}")
    class_of = np.zeros(len(kept), np.int64)
    return dataclasses.replace(kept, class_id=class_of, class_names=(name,))


def _check_overlaps(rows: TrackRows) -> None:
    assert rows.rles is not None
    by_frame: dict[int, list[Rle]] = {}
    frames = [*rows.frame.tolist(), *rows.ignored_frame.tolist()]
    for frame, rle in zip(frames, (*rows.rles, *rows.ignored_rles), strict=True):
        by_frame.setdefault(frame, []).append(rle)
    for frame, rles in by_frame.items():
        if len(rles) > 1 and int(mask_areas(rles).sum()) != union_area(rles):
            raise SourceError(
                f"{rows.file}, frame {frame + rows.first_frame}: masks overlap; in MOTS a pixel "
                "belongs to one object"
            )


def _require_class(class_id: int, *sides: TrackRows) -> None:
    """Makes sure that a class is there, if there are classes at all."""
    present = set(np.concatenate([rows.text_class for rows in sides]).tolist())
    present -= {UNKNOWN_CLASS} if sides[0].rles is None else {UNKNOWN_CLASS, MOTS_IGNORE_CLASS}
    are_boxes = sides[0].rles is None and any(map(len, sides))
    if (present or are_boxes) and class_id not in present:
        raise SourceError(
            f"{' and '.join(rows.file for rows in sides)} has no row of class {class_id}; it has "
            f"{', '.join(map(str, sorted(present))) or 'none that says its class'}"
        )


def _read_text(path: str | Path) -> str:
    with files.reading(path):
        return files.read_text(path, MAX_TEXT_BYTES)


def _read_numbers(path: str | Path) -> Float[np.ndarray, "N columns"]:
    """The rows of a MOTChallenge file, checked."""
    rows = [line for line in _read_text(path).splitlines() if line.strip()]
    if not rows:
        return np.zeros((0, 10))
    with files.reading(path):
        table = np.loadtxt(rows, delimiter="," if "," in rows[0] else None, ndmin=2, comments=None)
    if table.shape[1] < 6:
        raise SourceError(
            f"'{path}' has rows of {table.shape[1]} columns; MOTChallenge needs frame,id,left,top,"
            "width,height"
        )
    whole = table[:, :2]
    is_good = np.abs(table) <= _MAX_NUMBER
    is_good[:, :2] = (whole == np.round(whole)) & (np.abs(whole) <= _MAX_WHOLE)
    is_good[:, 4:6] &= table[:, 4:6] >= 0
    if not is_good.all():
        row, column = np.argwhere(~is_good)[0]
        raise SourceError(
            f"'{path}', row {row + 1}: column {column + 1} is {table[row, column]:g}; give whole "
            f"numbers as frame and id, sides of 0 or more, and finite numbers up to {_MAX_NUMBER:g}"
        )
    return table


def mot_lines(tracks: Iterable[Tracks]) -> list[str]:
    """MOTChallenge results: `frame,id,left,top,width,height,confidence,-1,-1,-1`.

    Ids, and frames as the source counts them, start at 1. Class and visibility are -1, as the
    challenge asks of results; classes are in `tracks.csv`.
    """
    lines = []
    for frame in tracks:
        for row in firm_rows(frame):
            left, top, right, bottom = frame.boxes[row]
            confidence = stated_confidence(frame, row)
            lines.append(
                f"{frame.source_index + 1},{frame.object_id[row] + 1},{left:.2f},{top:.2f},"
                f"{right - left:.2f},{bottom - top:.2f},{confidence:.4f},-1,-1,-1"
            )
    return lines


def mots_lines(tracks: Sequence[Tracks]) -> list[str]:
    """MOTS results: `frame id class height width rle`, numbered as in `mot_lines`.

    The format knows two classes: what is called "car" is one, all else has the other. An identity
    has one class, that of most of its rows. Masks of a frame may not overlap in this format: shared
    pixels go to the higher confidence.
    """
    label_of = main_labels(tracks, [*map(firm_ids, tracks)])
    lines = []
    for frame in tracks:
        rows = firm_rows(frame)
        height, width = frame.frame_size
        for row, rle in zip(rows, masks_without_overlap(frame, rows), strict=True):
            if rle is None:
                continue
            one = int(frame.object_id[row])
            is_car = label_of[one].strip().casefold() == MOTS_CLASSES[_MOTS_CAR]
            class_id = _MOTS_CAR if is_car else DEFAULT_MOTS_CLASS
            lines.append(
                f"{frame.source_index + 1} {one + 1} {class_id} "
                f"{height} {width} {rle['counts'].decode('ascii')}"
            )
    return lines
