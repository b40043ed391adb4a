"""Two text files, truth and predictions, as one sequence, read as TrackEval reads them.

MOTChallenge text compares boxes, MOTS and KITTI-MOTS text masks; see `mot_files`.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from remind_jax.errors import SourceError
from remind_jax.metrics.matching import EPSILON, match_frames
from remind_jax.metrics.mot_files import (
    MAX_FRAMES,
    MOTS_CLASSES,
    MOTS_IGNORE_CLASS,
    BoxRows,
    MaskRows,
    read_mot_rows,
    read_mots_rows,
)
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.similarity import (
    covered_share,
    find_overlap,
    merge_rles,
    pair_boxes,
    rle_iou,
)

# Classes of MOT16/17 that look like pedestrians without counting: person on vehicle, static
# person, distractor, reflection. MOT20 adds 6, non-motorised vehicle.
MOT17_DISTRACTORS = frozenset({2, 7, 8, 12})
MOT20_DISTRACTORS = MOT17_DISTRACTORS | {6}

_MATCH_THRESHOLD = 0.5
_IGNORED_SHARE = 0.5


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
    return pair_mot_files(
        gt_path, pred_path, num_frames=num_frames, class_id=class_id, distractors=distractors
    )[0]


def pair_mot_files(
    gt_path: str | Path,
    pred_path: str | Path,
    *,
    num_frames: int | None = None,
    class_id: int | None = None,
    distractors: Collection[int] = (),
) -> tuple[TrackingSequence, BoxRows]:
    """As `load_mot_sequence`; also the rows of truth as they stand in the sequence."""
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
        return sequence, gt
    return sequence.select(keep_gt, keep_pred), gt.select(keep_gt)


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
    return pair_mots_files(
        gt_path, pred_path, num_frames=num_frames, class_id=class_id, first_frame=first_frame
    )[0]


def pair_mots_files(
    gt_path: str | Path,
    pred_path: str | Path,
    *,
    num_frames: int | None = None,
    class_id: int = 2,
    first_frame: int = 1,
) -> tuple[TrackingSequence, MaskRows]:
    """As `load_mots_sequence`; also the rows of truth as they stand in the sequence."""
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
        return sequence, gt
    keep_pred = ~_find_ignored(pred, ignored)
    keep_pred[sequence.pair_pred[_match_detections(sequence)]] = True
    return sequence.select(np.ones(len(gt.frame), bool), keep_pred), gt


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
