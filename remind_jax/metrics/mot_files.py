"""Readers of MOTChallenge text (boxes) and MOTS / KITTI-MOTS text (masks).

MOTChallenge row: `frame,id,left,top,width,height,flag or score,class,visibility`; MOTS row:
`frame id class height width rle`. Rows come back ordered by frame, otherwise as in the file.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Collection
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.errors import SourceError
from remind_jax.metrics.decimal_text import parse_decimal_table
from remind_jax.metrics.matching import EPSILON, match_frames
from remind_jax.metrics.run_lengths import find_malformed
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.similarity import (
    covered_share,
    find_overlap,
    merge_rles,
    pair_boxes,
    rle_iou,
)
from remind_jax.tracks import Rle

FileFormat = Literal["mot", "mots", "kitti-mots"]

MOTS_CLASSES = {1: "car", 2: "pedestrian"}
MOTS_IGNORE_CLASS = 10

# Classes of MOT16/17 that look like pedestrians without counting: person on vehicle, static
# person, distractor, reflection. MOT20 adds 6, non-motorised vehicle.
MOT17_DISTRACTORS = frozenset({2, 7, 8, 12})
MOT20_DISTRACTORS = MOT17_DISTRACTORS | {6}

# A larger number is a time stamp or a damaged row; memory is taken by the number of frames.
MAX_FRAMES = 10_000_000

# Of frame,id,left,top,width,height,flag,class,...
_MOT_COLUMNS = 8

# Whole numbers up to here are exact as floats.
_MAX_WHOLE = 2.0**53

_MATCH_THRESHOLD = 0.5
_IGNORED_SHARE = 0.5


@dataclasses.dataclass(frozen=True)
class BoxRows:
    """Rows of a MOTChallenge file."""

    frame: Int[np.ndarray, "N"]  # as in the file, counted from 1
    track_id: Int[np.ndarray, "N"]
    boxes: Float[np.ndarray, "N 4"]  # left, top, right, bottom in pixels
    flag: Float[np.ndarray, "N"]  # ground truth: 0 is to be ignored; predictions: score
    class_id: Int[np.ndarray, "N"]  # -1 where the file has none


@dataclasses.dataclass(frozen=True)
class MaskRows:
    """Rows of a MOTS file."""

    frame: Int[np.ndarray, "N"]  # as in the file, counted from 1 (MOTS) or 0 (KITTI-MOTS)
    track_id: Int[np.ndarray, "N"]
    class_id: Int[np.ndarray, "N"]
    rles: tuple[Rle, ...]

    def select(self, keep: Bool[np.ndarray, "N"]) -> MaskRows:
        """The rows at `keep`, in that order."""
        rles = tuple(self.rles[row] for row in np.flatnonzero(keep))
        return MaskRows(self.frame[keep], self.track_id[keep], self.class_id[keep], rles)


def recognise_format(*paths: str | Path) -> FileFormat:
    """Tells MOTChallenge text from MOTS text by the first row of the first file that has one.

    Raises:
      SourceError: If a first row fits neither.
    """
    found: FileFormat = "mot"
    for path in paths:
        lines = _read_text(path).splitlines()
        first = next((line for line in lines if line.strip()), None)
        if first is None:
            continue
        if "," not in first and len(first.split()) == 6:
            starts_at_zero = any(line.split(" ", 1)[0] == "0" for line in lines)
            return "kitti-mots" if starts_at_zero else "mots"
        if len(_split_row(first)) < 6:
            raise SourceError(
                f"{path} is neither MOTChallenge text (frame,id,left,top,width,height,...) "
                f"nor MOTS text (frame id class height width rle); its first row is '{first[:60]}'"
            )
        return found
    return found


def read_mot_rows(path: str | Path) -> BoxRows:
    """Reads a MOTChallenge file; it may be empty.

    Raises:
      SourceError: If the file is missing, or a row is not numeric or has fewer than 6 columns.
    """
    table = _parse_numbers(path)
    table = _order_by_frame(table)
    boxes = table[:, 2:6].copy()
    boxes[:, 2:] += boxes[:, :2]
    flag = table[:, 6] if table.shape[1] > 6 else np.ones(len(table))
    class_id = table[:, 7].astype(np.int64) if table.shape[1] > 7 else np.full(len(table), -1)
    return BoxRows(
        table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), boxes, flag, class_id
    )


def read_mots_rows(path: str | Path) -> MaskRows:
    """Reads a MOTS or KITTI-MOTS file; it may be empty.

    Raises:
      SourceError: If the file is missing, or a row does not have its six columns.
    """
    numbers: list[tuple[int, int, int]] = []
    rles: list[Rle] = []
    for line_number, line in enumerate(_read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        try:
            frame, track_id, class_id, height, width, counts = line.split()
            numbers.append((int(frame), int(track_id), int(class_id)))
            rles.append({"size": [int(height), int(width)], "counts": counts.encode()})
        except ValueError:
            raise SourceError(
                f"{path}, line {line_number}: '{line[:60]}' is not a MOTS row; "
                "it needs frame id class height width rle, separated by spaces"
            ) from None
    wrong = find_malformed(rles)
    if wrong is not None:
        frame, track_id, _ = numbers[wrong]
        height, width = rles[wrong]["size"]
        raise SourceError(
            f"{path}, frame {frame}, id {track_id}: the run lengths are damaged or do not add up "
            f"to a mask of {height} x {width} pixels (height x width)"
        )
    rows = np.asarray([(*row, at) for at, row in enumerate(numbers)], np.int64).reshape(-1, 4)
    frame, track_id, class_id, place = _order_by_frame(rows).T
    return MaskRows(frame, track_id, class_id, tuple(rles[at] for at in place))


def load_mot_sequence(
    gt_path: str | Path,
    pred_path: str | Path,
    *,
    num_frames: int | None = None,
    class_id: int | None = None,
    distractors: Collection[int] = (),
) -> TrackingSequence:
    """Reads boxes of ground truth and predictions; ground-truth rows with flag 0 are left out.

    Args:
      gt_path: MOTChallenge ground truth.
      pred_path: MOTChallenge predictions.
      num_frames: Length of the sequence; the last frame of either file if left out.
      class_id: Ground-truth class to keep (1, pedestrian, for MOT16/17/20); all if left out.
      distractors: Ground-truth classes whose matched predictions are left out, for example
        `MOT17_DISTRACTORS`.

    Raises:
      SourceError: If a file cannot be read, or breaks a rule of `TrackingSequence.create`.
    """
    gt, pred = read_mot_rows(gt_path), read_mot_rows(pred_path)
    num_frames = _sequence_length(1, num_frames, {gt_path: gt.frame, pred_path: pred.frame})
    pairs = pair_boxes(gt.frame - 1, gt.boxes, pred.frame - 1, pred.boxes, num_frames)
    sequence = TrackingSequence.create(
        num_frames,
        (gt.frame - 1, gt.track_id),
        (pred.frame - 1, pred.track_id),
        pairs,
        name=str(pred_path),
        first_frame=1,
    )
    keep_pred = np.ones(len(pred.frame), bool)
    if distractors:
        matched = _match_detections(sequence)
        is_distractor = np.isin(gt.class_id[sequence.pair_gt[matched]], list(distractors))
        keep_pred[sequence.pair_pred[matched][is_distractor]] = False
    keep_gt = gt.flag != 0
    if class_id is not None:
        keep_gt &= gt.class_id == class_id
    if keep_gt.all() and keep_pred.all():
        return sequence
    return sequence.select(keep_gt, keep_pred)


def load_mots_sequence(
    gt_path: str | Path,
    pred_path: str | Path,
    *,
    num_frames: int | None = None,
    class_id: int = 2,
    first_frame: int = 1,
) -> TrackingSequence:
    """Reads masks of one class of ground truth and predictions.

    Unmatched predictions that lie by more than half inside an ignore region (class 10 of the ground
    truth) are left out.

    Args:
      gt_path: MOTS ground truth.
      pred_path: MOTS predictions.
      num_frames: Length of the sequence; up to the last frame of either file if left out.
      class_id: 2 pedestrian, 1 car.
      first_frame: Number of the first frame: 1 in MOTS, 0 in KITTI-MOTS.

    Raises:
      SourceError: If a file cannot be read, masks of one frame overlap, rows are of other classes
        only, or a rule of `TrackingSequence.create` is broken.
    """
    all_gt, all_pred = read_mots_rows(gt_path), read_mots_rows(pred_path)
    frames = {gt_path: all_gt.frame, pred_path: all_pred.frame}
    num_frames = _sequence_length(first_frame, num_frames, frames)
    _check_classes(gt_path, class_id, all_gt, all_pred)
    for path, rows in ((gt_path, all_gt), (pred_path, all_pred)):
        _check_overlaps(path, rows)
    gt, pred = (rows.select(rows.class_id == class_id) for rows in (all_gt, all_pred))
    sequence = TrackingSequence.create(
        num_frames,
        (gt.frame - first_frame, gt.track_id),
        (pred.frame - first_frame, pred.track_id),
        _pair_rles(gt, pred),
        class_names=(MOTS_CLASSES.get(class_id, f"class {class_id}"),),
        name=str(pred_path),
        first_frame=first_frame,
    )
    ignored = all_gt.select(all_gt.class_id == MOTS_IGNORE_CLASS)
    if not len(ignored.frame):
        return sequence
    keep_pred = ~_find_ignored(pred, ignored)
    keep_pred[sequence.pair_pred[_match_detections(sequence)]] = True
    return sequence.select(np.ones(len(gt.frame), bool), keep_pred)


def _match_detections(sequence: TrackingSequence) -> Bool[np.ndarray, "K"]:
    """Matches for preprocessing: largest total similarity among pairs of at least one half."""
    similarity = sequence.pair_similarity
    return match_frames(
        sequence, np.where(similarity >= _MATCH_THRESHOLD - EPSILON, similarity, 0.0)
    )


def _pair_rles(gt: MaskRows, pred: MaskRows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
    for frame in np.intersect1d(gt.frame, pred.frame):
        first_gt, stop_gt = np.searchsorted(gt.frame, [frame, frame + 1])
        first_pred, stop_pred = np.searchsorted(pred.frame, [frame, frame + 1])
        matrix = rle_iou(gt.rles[first_gt:stop_gt], pred.rles[first_pred:stop_pred])
        row, column = np.nonzero(matrix)
        parts.append((row + first_gt, column + first_pred, matrix[row, column]))
    rows, columns, ious = (np.concatenate(column) for column in zip(*parts, strict=True))
    return rows, columns, ious


def _find_ignored(pred: MaskRows, ignored: MaskRows) -> Bool[np.ndarray, "N"]:
    is_ignored = np.zeros(len(pred.frame), bool)
    for frame in np.intersect1d(pred.frame, ignored.frame):
        first, stop = np.searchsorted(pred.frame, [frame, frame + 1])
        regions = [ignored.rles[row] for row in np.flatnonzero(ignored.frame == frame)]
        share = covered_share(pred.rles[first:stop], merge_rles(regions))
        is_ignored[first:stop] = share > _IGNORED_SHARE + EPSILON
    return is_ignored


def _check_classes(path: str | Path, class_id: int, *sides: MaskRows) -> None:
    present = {int(found) for rows in sides for found in np.unique(rows.class_id)}
    present.discard(MOTS_IGNORE_CLASS)
    if present and class_id not in present:
        raise SourceError(
            f"{path} and its predictions have no row of class {class_id}; "
            f"they have {', '.join(map(str, sorted(present)))}"
        )


def _check_overlaps(path: str | Path, rows: MaskRows) -> None:
    for frame in np.unique(rows.frame):
        first, stop = np.searchsorted(rows.frame, [frame, frame + 1])
        if find_overlap(rows.rles[first:stop]):
            raise SourceError(
                f"{path}, frame {frame}: masks overlap; in MOTS a pixel belongs to one object"
            )


def _sequence_length(
    first_frame: int, num_frames: int | None, frames: dict[str | Path, np.ndarray]
) -> int:
    _check_frames(frames)
    last = max((int(frame[-1]) for frame in frames.values() if len(frame)), default=first_frame - 1)
    length = last - first_frame + 1 if num_frames is None else num_frames
    for path, frame in frames.items():
        if len(frame) and (frame[0] < first_frame or frame[-1] >= first_frame + length):
            wrong = frame[0] if frame[0] < first_frame else frame[-1]
            raise SourceError(
                f"{path} has a row of frame {wrong}; frames are numbered "
                f"{first_frame} to {first_frame + length - 1}"
            )
    return length


def _check_frames(frames: dict[str | Path, np.ndarray]) -> None:
    for path, frame in frames.items():
        if len(frame) and frame[-1] > MAX_FRAMES:
            raise SourceError(
                f"{path} has a row of frame {frame[-1]}; frames are numbered up to {MAX_FRAMES}"
            )


def _order_by_frame(table: np.ndarray) -> np.ndarray:
    if np.any(np.diff(table[:, 0]) < 0):
        return table[np.argsort(table[:, 0], kind="stable")]
    return table


def _read_bytes(path: str | Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror}") from None


def _read_text(path: str | Path) -> str:
    try:
        return _read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise SourceError(f"{path} is not a text file; give MOTChallenge or MOTS text") from None


def _split_row(line: str) -> list[str]:
    return line.split(",") if "," in line else line.split()


def _parse_numbers(path: str | Path) -> Float[np.ndarray, "N columns"]:
    table = parse_decimal_table(_read_bytes(path), _MOT_COLUMNS)
    if table is None:
        table = _parse_any_numbers(path)
    if table.shape[1] < 6 or not np.isfinite(table[:, :6]).all():
        raise SourceError(
            f"{path} has rows of {table.shape[1]} columns; MOTChallenge needs frame,id,left,top,"
            "width,height and finite numbers"
        )
    whole = table[:, :2]
    wrong = np.argwhere((whole != np.round(whole)) | (np.abs(whole) > _MAX_WHOLE))
    if len(wrong):
        row, column = wrong[0]
        raise SourceError(
            f"{path}, row {row + 1}: {('frame', 'id')[column]} is {whole[row, column]}; "
            "it must be a whole number"
        )
    return table


def _parse_any_numbers(path: str | Path) -> Float[np.ndarray, "N columns"]:
    text = _read_text(path)
    if not text.strip():
        return np.zeros((0, 10))
    delimiter = "," if "," in text.split("\n", 1)[0] else None
    try:
        return np.loadtxt(io.StringIO(text), delimiter=delimiter, ndmin=2, comments=None)
    except ValueError:
        number, row = _find_bad_row(text, delimiter)
        raise SourceError(
            f"{path} is not MOTChallenge text: row {number} is '{row[:60]}'; every row needs the "
            "same columns of numbers, frame,id,left,top,width,height,..."
        ) from None


def _find_bad_row(text: str, delimiter: str | None) -> tuple[int, str]:
    """Number and text of the first row that is not numeric or not as long as the first."""
    rows = [(number, row) for number, row in enumerate(text.splitlines(), 1) if row.strip()]
    for number, row in rows:
        cells = row.split(delimiter)
        try:
            is_good = len([float(cell) for cell in cells]) == len(rows[0][1].split(delimiter))
        except ValueError:
            is_good = False
        if not is_good:
            return number, row.strip()
    return rows[0]
