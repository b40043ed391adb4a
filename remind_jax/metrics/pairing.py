"""Brings truth and predictions of one scene together: frames, overlaps, classes.

Classes are compared where both sides name all rows and share one; else every pair may match.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from hotcoco import mask as coco
from jaxtyping import Bool, Float, Int

from remind_jax.errors import SourceError
from remind_jax.formats.rows import UNKNOWN_CLASS, TrackRows, boxes_of, size_of
from remind_jax.frame import Rle
from remind_jax.masks.run_length import decode_mask, encode_masks
from remind_jax.metrics.matching import EPSILON, match_detections
from remind_jax.metrics.sequence import ANY_CLASS, TrackingSequence
from remind_jax.sources.file_tree import frame_stem, last_number
from remind_jax.sources.label_maps import fit_plane

Pairs = tuple[Int[np.ndarray, "K"], Int[np.ndarray, "K"], Float[np.ndarray, "K"]]


def box_iou(
    gt: Float[np.ndarray, "G 4"], pred: Float[np.ndarray, "P 4"]
) -> Float[np.ndarray, "G P"]:
    """Intersection over union of boxes of one frame: left, top, right, bottom."""
    # The order of operations is TrackEval's: an overlap on a threshold must round as there.
    gt, pred = gt.T[:, :, None], pred.T[:, None]
    width = np.minimum(gt[2], pred[2]) - np.maximum(gt[0], pred[0])
    height = np.minimum(gt[3], pred[3]) - np.maximum(gt[1], pred[1])
    intersection = np.maximum(width, 0) * np.maximum(height, 0)
    gt_area = (gt[2] - gt[0]) * (gt[3] - gt[1])
    pred_area = (pred[2] - pred[0]) * (pred[3] - pred[1])
    union = gt_area + pred_area - intersection
    counts = (gt_area > EPSILON) & (pred_area > EPSILON) & (union > EPSILON)
    return np.where(counts, intersection / np.where(counts, union, 1.0), 0.0)


def rle_iou(gt_rles: Sequence[Rle], pred_rles: Sequence[Rle]) -> Float[np.ndarray, "G P"]:
    """Intersection over union of run-length encoded masks of one frame.

    Raises:
      SourceError: If the masks are not all of one size.
    """
    sizes = {tuple(rle["size"]) for rle in (*gt_rles, *pred_rles)}
    if len(sizes) > 1:
        raise SourceError(
            f"masks of one frame have different sizes {sorted(sizes)}; "
            "give ground truth and predictions at the same height and width"
        )
    if not gt_rles or not pred_rles:
        return np.zeros((len(gt_rles), len(pred_rles)))
    return np.asarray(coco.iou(list(gt_rles), list(pred_rles), [0] * len(pred_rles)), float)


def covered_share(rles: Sequence[Rle], region: Rle) -> Float[np.ndarray, "N"]:
    """Share of each mask that lies inside a region (MOTS ignore regions); 0 for empty masks."""
    if not rles:
        return np.zeros(0)
    # With `iscrowd` set, the library divides by the area of the first mask alone.
    return np.asarray(coco.iou(list(rles), [region], [1]), float)[:, 0]


NOT_ALIGNED = -1

_IGNORED_SHARE = 0.5


@dataclasses.dataclass(frozen=True)
class PairedScene:
    """A scene ready to be scored, and what was left out on the way."""

    sequence: TrackingSequence
    notes: tuple[str, ...] = ()


def pair_scene(truth: TrackRows, prediction: TrackRows) -> PairedScene:
    """Aligns frames and measures overlaps.

    Predictions in frames that the truth does not have are left out, with a note. Void pixels of
    the truth (DAVIS) are cut out of predicted masks; a prediction of which nothing is left counts
    as nothing. Predictions of which more than half lies in an ignore region (MOTS) are left out,
    unless they match an object.

    Raises:
      SourceError: If frames cannot be aligned, frame sizes do not fit, or an id occurs twice in a
        frame.
    """
    truth, prediction, notes = _align(truth, prediction)
    if truth.is_void:
        prediction = _cut_void(truth, prediction)
    pairs = _measure(truth, prediction)
    gt_class, pred_class, class_names = _join_classes(truth, prediction)
    sequence = TrackingSequence.create(
        truth.num_frames,
        (truth.frame, truth.track_id),
        (prediction.frame, prediction.track_id),
        pairs,
        gt_class=gt_class,
        pred_class=pred_class,
        class_names=class_names,
        name=prediction.name,
        first_frame=min(truth.first_frame, prediction.first_frame),
    )
    if truth.is_void or not len(truth.ignored_frame) or prediction.rles is None:
        return PairedScene(sequence, notes)
    keep = ~_find_ignored(truth, prediction)
    keep[match_detections(sequence)[1]] = True
    everything = np.ones(len(truth), bool)
    return PairedScene(sequence.select(everything, keep), notes)


def align_frames(
    truth_names: Sequence[str], prediction_names: Sequence[str], name: str
) -> Int[np.ndarray, "frames"]:
    """Place of each predicted frame among those of the truth, NOT_ALIGNED if it is not there.

    Raises:
      SourceError: If nothing agrees.
    """
    keys_of: tuple[Callable[[str], Any], ...] = (frame_stem, last_number)
    for key in keys_of:
        keys = [key(frame) for frame in truth_names]
        place: dict[Any, int] = {k: i for i, k in enumerate(keys) if k is not None}
        found = [place.get(key(n), NOT_ALIGNED) if n else NOT_ALIGNED for n in prediction_names]
        if len(place) == len(truth_names) and max(found, default=0) > NOT_ALIGNED:
            return np.asarray(found, np.int64)
    if len(truth_names) == len(prediction_names):
        return np.arange(len(truth_names))
    raise SourceError(
        f"{name}: no predicted frame ('{prediction_names[0]}', ...) is named or numbered like one "
        f"of the truth ('{truth_names[0]}', ...), and their counts differ "
        f"({len(prediction_names)} and {len(truth_names)})"
    )


def _align(truth: TrackRows, prediction: TrackRows) -> tuple[TrackRows, TrackRows, tuple[str, ...]]:
    if truth.frame_names and prediction.frame_names:
        place = align_frames(truth.frame_names, prediction.frame_names, prediction.name)
    else:
        place = _numbers(prediction)
        if truth.frame_names or truth.source_frames is not None:
            place_of = {one: at for at, one in enumerate(_numbers(truth).tolist())}
            place = np.array([place_of.get(one, NOT_ALIGNED) for one in place.tolist()], np.int64)
        num_frames = max(truth.num_frames, int(place.max(initial=-1)) + 1)
        truth = dataclasses.replace(truth, num_frames=num_frames)
    new_frame = place[prediction.frame]
    known = new_frame != NOT_ALIGNED
    moved = dataclasses.replace(
        prediction.select(known), frame=new_frame[known], num_frames=truth.num_frames
    )
    if np.any(np.diff(moved.frame) < 0):
        moved = moved.select(np.argsort(moved.frame, kind="stable"))
    notes = []
    if not known.all():
        num_left_out = len(np.unique(prediction.frame[~known]))
        why = ""
        if truth.frame_names and truth.source_frames is None and not prediction.frame_names:
            why = (
                f"; without names, the first frame is '{truth.frame_names[0]}', "
                f"the first of {len(truth.frame_names)} pictures of the truth"
            )
        notes.append(f"{num_left_out} predicted frames that the truth lacks are left out{why}")
    looked_at = np.unique(place[place != NOT_ALIGNED])
    num_lacking = truth.num_frames - len(looked_at)
    if prediction.is_sampled and num_lacking:
        notes.append(f"{len(looked_at)} of {truth.num_frames} frames were processed")
        truth, moved = (_keep_frames(side, looked_at) for side in (truth, moved))
    elif num_lacking and (
        prediction.source_frames is not None or (truth.frame_names and prediction.frame_names)
    ):
        notes.append(
            f"{num_lacking} of {truth.num_frames} frames are not in the predictions and count as "
            "missed; where a run left them out, give its folder"
        )
    return truth, moved, tuple(notes)


def _numbers(rows: TrackRows) -> Int[np.ndarray, "frames"]:
    """Numbers of the frames in the source, where they are known."""
    return np.arange(rows.num_frames) if rows.source_frames is None else rows.source_frames


def _keep_frames(rows: TrackRows, frames: Int[np.ndarray, "T"]) -> TrackRows:
    """The scene with only some frames, numbered anew."""
    place = np.full(rows.num_frames, NOT_ALIGNED)
    place[frames] = np.arange(len(frames))
    kept = rows.select(place[rows.frame] != NOT_ALIGNED)
    is_kept = place[rows.ignored_frame] != NOT_ALIGNED
    return dataclasses.replace(
        kept,
        frame=place[kept.frame],
        num_frames=len(frames),
        frame_names=None,
        ignored_frame=place[rows.ignored_frame[is_kept]],
        ignored_rles=tuple(r for r, k in zip(rows.ignored_rles, is_kept, strict=True) if k),
    )


def _measure(truth: TrackRows, prediction: TrackRows) -> Pairs:
    """Overlapping rows of truth and predictions, and their intersection over union."""
    overlap: Callable[[Any, Any], np.ndarray]
    sides: tuple[Any, Any]
    if has_masks := bool(truth.rles and prediction.rles):
        overlap, sides = rle_iou, (truth.rles, prediction.rles)
    else:
        overlap, sides = box_iou, _boxes_in_one_size(truth, prediction)
    parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
    for frame in np.intersect1d(truth.frame, prediction.frame):
        first, stop = np.searchsorted(truth.frame, [frame, frame + 1])
        first_pred, stop_pred = np.searchsorted(prediction.frame, [frame, frame + 1])
        true: Any = sides[0][first:stop]
        found: Any = sides[1][first_pred:stop_pred]
        if has_masks:
            found = _fit_masks(found, size_of(true[0]), prediction.name)
        matrix = overlap(true, found)
        row, column = np.nonzero(matrix)
        parts.append((row + first, column + first_pred, matrix[row, column]))
    rows, columns, ious = (np.concatenate(column) for column in zip(*parts, strict=True))
    return rows, columns, ious


def _boxes_in_one_size(truth: TrackRows, prediction: TrackRows) -> tuple[np.ndarray, np.ndarray]:
    if truth.frame_size is None or prediction.frame_size is None:
        return truth.boxes, prediction.boxes
    scale = np.divide(truth.frame_size, prediction.frame_size)[[1, 0, 1, 0]]
    return truth.boxes, prediction.boxes * scale


def _fit_masks(rles: Sequence[Rle], size: tuple[int, int], name: str) -> tuple[Rle, ...]:
    """Masks at another height and width, where only the scale differs."""
    what = f"{name}: a predicted mask"
    return tuple(
        rle
        if size_of(rle) == size
        else encode_masks(fit_plane(decode_mask(rle), size, what)[None] > 0)[0]
        for rle in rles
    )


def _join_classes(
    truth: TrackRows, prediction: TrackRows
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Class index per row of both sides; one class for all where a side names none."""
    sides = (truth, prediction)
    if not have_common_classes(truth, prediction):
        return np.zeros(len(truth), np.int64), np.zeros(len(prediction), np.int64), (ANY_CLASS,)
    keys = {class_key(name): name for side in (prediction, truth) for name in side.class_names}
    order = {key: place for place, key in enumerate(sorted(keys))}
    numbers = [
        np.array([order[class_key(name)] for name in side.class_names] or [0])[side.class_id]
        if len(side)
        else np.zeros(0, np.int64)
        for side in sides
    ]
    return numbers[0], numbers[1], tuple(keys[key] for key in order) or (ANY_CLASS,)


def have_common_classes(truth: TrackRows, prediction: TrackRows) -> bool:
    """Whether all rows of both sides are named, in words that both use or may use."""
    sides = (truth, prediction)
    if any((side.class_id == UNKNOWN_CLASS).any() for side in sides):
        return False
    known = [{*map(class_key, side.class_names)} for side in sides]
    if known[0] == known[1]:  # as of results for a data set: none in common are errors then
        return True
    used = [{class_key(s.class_names[i]) for i in np.unique(s.class_id)} for s in sides]
    return bool(used[0] & used[1]) or not (used[0] and used[1])


def class_key(name: str) -> str:
    """A class name as it is compared."""
    return name.strip().casefold()


def _cut_void(truth: TrackRows, prediction: TrackRows) -> TrackRows:
    """Predictions without the void pixels of the truth, and without those that lie wholly there."""
    if prediction.rles is None or not len(truth.ignored_frame):
        return prediction
    rles, keep = list(prediction.rles), np.ones(len(prediction), bool)
    for frame, void in zip(truth.ignored_frame, truth.ignored_rles, strict=True):
        first, stop = np.searchsorted(prediction.frame, [frame, frame + 1])
        fitted = _fit_masks(rles[first:stop], size_of(void), prediction.name)
        for row, share in enumerate(covered_share(fitted, void), first):
            if share == 0:
                continue
            left = decode_mask(fitted[row - first]) & (1 - decode_mask(void))
            rles[row] = encode_masks(left[None] > 0)[0]
            keep[row] = left.any()
    return dataclasses.replace(prediction, rles=tuple(rles), boxes=boxes_of(rles)).select(keep)


def _find_ignored(truth: TrackRows, prediction: TrackRows) -> Bool[np.ndarray, "N"]:
    is_ignored = np.zeros(len(prediction), bool)
    assert prediction.rles is not None
    for frame in np.intersect1d(prediction.frame, truth.ignored_frame):
        first, stop = np.searchsorted(prediction.frame, [frame, frame + 1])
        at = np.flatnonzero(truth.ignored_frame == frame)
        region: Rle = coco.merge([truth.ignored_rles[row] for row in at])
        rles = _fit_masks(prediction.rles[first:stop], size_of(region), prediction.name)
        is_ignored[first:stop] = covered_share(rles, region) > _IGNORED_SHARE + EPSILON
    return is_ignored
