"""How much two detections overlap: intersection over union of boxes and of masks.

Letters: `G` ground truths, `P` predictions, `K` overlapping pairs, `H W` pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from pycocotools import mask as coco_mask

from remind_jax.errors import SourceError
from remind_jax.masks.run_length import mask_areas, union_area
from remind_jax.metrics.sequence import frame_starts
from remind_jax.tracks import Rle

_EPSILON = float(np.finfo(np.float64).eps)

# Box pairs looked at in one go: temporaries of this size stay in the cache.
_PAIRS_PER_CHUNK = 1 << 15

# Pixel counts up to here are exact in single precision.
_EXACT_FLOAT32 = 1 << 24

# Never overlaps anything, itself included: left, top, right, bottom.
_NOWHERE = (np.inf, np.inf, -np.inf, -np.inf)

Pairs = tuple[Int[np.ndarray, "K"], Int[np.ndarray, "K"], Float[np.ndarray, "K"]]


def box_iou(
    gt_boxes: Float[np.ndarray, "G 4"], pred_boxes: Float[np.ndarray, "P 4"]
) -> Float[np.ndarray, "G P"]:
    """Intersection over union of boxes given as left, top, right, bottom (right, bottom excluded).

    Boxes of no area (or of negative width or height) overlap nothing.
    """
    gt_boxes, pred_boxes = np.asarray(gt_boxes, float), np.asarray(pred_boxes, float)
    matrix = np.zeros((len(gt_boxes), len(pred_boxes)))
    gt_frame, pred_frame = np.zeros(len(gt_boxes), int), np.zeros(len(pred_boxes), int)
    row, column, iou = pair_boxes(gt_frame, gt_boxes, pred_frame, pred_boxes, num_frames=1)
    matrix[row, column] = iou
    return matrix


def pair_boxes(
    gt_frame: Int[np.ndarray, "G"],
    gt_boxes: Float[np.ndarray, "G 4"],
    pred_frame: Int[np.ndarray, "P"],
    pred_boxes: Float[np.ndarray, "P 4"],
    num_frames: int,
) -> Pairs:
    """Overlapping boxes of a whole sequence: row of each, and their intersection over union.

    Args:
      gt_frame: Frame of each ground truth, not falling.
      gt_boxes: Left, top, right, bottom; right and bottom excluded.
      pred_frame: Frame of each prediction, not falling.
      pred_boxes: As `gt_boxes`.
      num_frames: Length of the sequence.
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
    return _iou(gt_rles, pred_rles, is_crowd=False)


def mask_iou(
    gt_masks: Bool[np.ndarray, "G H W"], pred_masks: Bool[np.ndarray, "P H W"]
) -> Float[np.ndarray, "G P"]:
    """Intersection over union of pixel masks; they may overlap each other.

    Raises:
      SourceError: If the frames differ in size.
    """
    gt_masks, pred_masks = np.asarray(gt_masks, bool), np.asarray(pred_masks, bool)
    _check_sizes(gt_masks.shape[1:], pred_masks.shape[1:])
    num_pixels = int(np.prod(gt_masks.shape[1:]))
    precision = np.float32 if num_pixels <= _EXACT_FLOAT32 else np.float64
    gt = gt_masks.reshape(len(gt_masks), num_pixels).astype(precision)
    pred = pred_masks.reshape(len(pred_masks), num_pixels).astype(precision)
    return _divide_areas((gt @ pred.T).astype(float), gt.sum(1), pred.sum(1))


def label_map_iou(
    gt_map: Int[np.ndarray, "H W"],
    gt_ids: Int[np.ndarray, "G"],
    pred_map: Int[np.ndarray, "H W"],
    pred_ids: Int[np.ndarray, "P"],
) -> Float[np.ndarray, "G P"]:
    """Intersection over union of the instances of two label maps.

    Args:
      gt_map: Instance id per pixel.
      gt_ids: Ids to look at, each once; the others (background) are left out.
      pred_map: As `gt_map`.
      pred_ids: As `gt_ids`.

    Raises:
      SourceError: If the maps differ in size.
    """
    _check_sizes(np.shape(gt_map), np.shape(pred_map))
    gt, pred = _number_pixels(gt_map, gt_ids), _number_pixels(pred_map, pred_ids)
    shape = len(gt_ids) + 1, len(pred_ids) + 1
    joint = np.bincount(gt * shape[1] + pred, minlength=shape[0] * shape[1]).reshape(shape)
    return _divide_areas(joint[:-1, :-1].astype(float), joint.sum(1)[:-1], joint.sum(0)[:-1])


def covered_share(rles: Sequence[Rle], region: Rle) -> Float[np.ndarray, "N"]:
    """Share of each mask that lies inside a region (MOTS ignore regions); 0 for empty masks."""
    if not rles:
        return np.zeros(0)
    # With `iscrowd` set, pycocotools divides by the area of the first mask alone.
    return _iou(rles, [region], is_crowd=True)[:, 0]


def find_overlap(rles: Sequence[Rle]) -> bool:
    """Whether any two masks of a frame share a pixel, which MOTS forbids."""
    if len(rles) < 2:
        return False
    return int(mask_areas(rles).sum()) != union_area(rles)


def merge_rles(rles: Sequence[Rle]) -> Rle:
    """The union of masks."""
    merged: Any = coco_mask.merge(_as_coco(list(rles)), intersect=False)
    return merged


def _iou(rles: Sequence[Rle], others: Sequence[Rle], *, is_crowd: bool) -> Float[np.ndarray, "N M"]:
    crowd = [int(is_crowd)] * len(others)
    return np.asarray(coco_mask.iou(_as_coco(list(rles)), _as_coco(list(others)), crowd), float)


def _as_coco(rles: Any) -> Any:
    # pycocotools types its masks as a class of its own; they are plain dictionaries.
    return rles


def _number_pixels(label_map: np.ndarray, ids: np.ndarray) -> Int[np.ndarray, "pixels"]:
    """Position of each pixel's id in `ids`; `len(ids)` for any other."""
    label_map, ids = np.asarray(label_map).ravel(), np.asarray(ids)
    if not len(ids):
        return np.zeros(label_map.size, np.int64)
    order = np.argsort(ids)
    place = np.minimum(np.searchsorted(ids[order], label_map), len(ids) - 1)
    return np.where(ids[order][place] == label_map, order[place], len(ids))


def _divide_areas(
    intersection: Float[np.ndarray, "G P"], gt_area: np.ndarray, pred_area: np.ndarray
) -> Float[np.ndarray, "G P"]:
    union = gt_area[:, None].astype(float) + pred_area[None].astype(float) - intersection
    return np.where(intersection > 0, intersection / np.maximum(union, 1.0), 0.0)


def _check_sizes(gt_size: tuple[int, ...], pred_size: tuple[int, ...]) -> None:
    if tuple(gt_size) != tuple(pred_size):
        raise SourceError(
            f"ground truth is {tuple(gt_size)} and predictions are {tuple(pred_size)} pixels; "
            "give both at the same height and width"
        )
