"""How much two detections overlap: intersection over union of boxes and of masks.

Letters: `G` ground truths, `P` predictions, `K` overlapping pairs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hotcoco import mask as coco
from jaxtyping import Float, Int

from remind_jax.errors import SourceError
from remind_jax.frame import Rle
from remind_jax.metrics.sequence import frame_starts

_EPSILON = float(np.finfo(np.float64).eps)

# Box pairs looked at in one go: temporaries of this size stay in the cache.
_PAIRS_PER_CHUNK = 1 << 15

# Never overlaps anything, itself included: left, top, right, bottom.
_NOWHERE = (np.inf, np.inf, -np.inf, -np.inf)

Pairs = tuple[Int[np.ndarray, "K"], Int[np.ndarray, "K"], Float[np.ndarray, "K"]]


def pair_boxes(
    gt_frame: Int[np.ndarray, "G"],
    gt_boxes: Float[np.ndarray, "G 4"],
    pred_frame: Int[np.ndarray, "P"],
    pred_boxes: Float[np.ndarray, "P 4"],
    num_frames: int,
) -> Pairs:
    """Overlapping boxes of a whole sequence: row of each, and their intersection over union.

    Frames do not fall; boxes are left, top, right, bottom; right and bottom excluded.
    """
    gt_start, pred_start = frame_starts(gt_frame, num_frames), frame_starts(pred_frame, num_frames)
    gt_edges = np.vstack([gt_boxes.reshape(-1, 4), _NOWHERE]).T
    pred_edges = np.vstack([pred_boxes.reshape(-1, 4), _NOWHERE]).T
    rows: list[np.ndarray] = [np.zeros(0, np.int64)]
    columns: list[np.ndarray] = [np.zeros(0, np.int64)]
    for frames in _cut_frames(np.diff(gt_start), np.diff(pred_start)):
        gt_slot = _slot_rows(gt_start, frames)
        pred_slot = _slot_rows(pred_start, frames)
        left, top, right, bottom = gt_edges[:, gt_slot, None]
        other_left, other_top, other_right, other_bottom = pred_edges[:, pred_slot][:, :, None]
        overlaps = (left < other_right) & (other_left < right)
        overlaps &= (top < other_bottom) & (other_top < bottom)
        hit, column = np.divmod(np.flatnonzero(overlaps), pred_slot.shape[1])
        rows.append(gt_slot.ravel()[hit])
        columns.append(pred_slot[hit // gt_slot.shape[1], column])
    row, column = np.concatenate(rows), np.concatenate(columns)
    iou = _divide_boxes(gt_edges[:, row], pred_edges[:, column])
    found = iou > 0
    return row[found], column[found], iou[found]


def _divide_boxes(
    gt: Float[np.ndarray, "4 K"], pred: Float[np.ndarray, "4 K"]
) -> Float[np.ndarray, "K"]:
    # The order of operations is TrackEval's: an overlap on a threshold must round as there.
    width = np.minimum(gt[2], pred[2]) - np.maximum(gt[0], pred[0])
    height = np.minimum(gt[3], pred[3]) - np.maximum(gt[1], pred[1])
    intersection = np.maximum(width, 0) * np.maximum(height, 0)
    gt_area = (gt[2] - gt[0]) * (gt[3] - gt[1])
    pred_area = (pred[2] - pred[0]) * (pred[3] - pred[1])
    union = gt_area + pred_area - intersection
    counts = (gt_area > _EPSILON) & (pred_area > _EPSILON) & (union > _EPSILON)
    return np.where(counts, intersection / np.where(counts, union, 1.0), 0.0)


def _cut_frames(gt_counts: np.ndarray, pred_counts: np.ndarray) -> list[np.ndarray]:
    """Frames that hold pairs, in groups of about `_PAIRS_PER_CHUNK` pairs."""
    frames = np.flatnonzero((gt_counts > 0) & (pred_counts > 0))
    total = np.cumsum(gt_counts[frames] * pred_counts[frames])
    group = total // _PAIRS_PER_CHUNK
    return np.split(frames, np.flatnonzero(np.diff(group)) + 1) if len(frames) else []


def _slot_rows(start: np.ndarray, frames: np.ndarray) -> Int[np.ndarray, "frames slots"]:
    """Rows of each frame, filled up with the row after the last one."""
    first, stop = start[frames, None], start[frames + 1, None]
    rows = first + np.arange(int((stop - first).max()))
    return np.where(rows < stop, rows, start[-1])


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


def merge_rles(rles: Sequence[Rle]) -> Rle:
    """The union of masks."""
    return coco.merge(list(rles))
