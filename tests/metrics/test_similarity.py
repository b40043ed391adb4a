from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.errors import SourceError
from remind_jax.masks.run_length import encode_masks
from remind_jax.metrics import pairing
from remind_jax.metrics.pairing import pair_boxes, rle_iou


def box_iou(gt_boxes: np.ndarray, pred_boxes: np.ndarray) -> np.ndarray:
    """Overlaps of all boxes with all boxes, as if they were of one frame."""
    matrix = np.zeros((len(gt_boxes), len(pred_boxes)))
    frames = (np.zeros(len(boxes), int) for boxes in (gt_boxes, pred_boxes))
    row, column, iou = pair_boxes(next(frames), gt_boxes, next(frames), pred_boxes, 1)
    matrix[row, column] = iou
    return matrix


def mask_iou(gt: np.ndarray, pred: np.ndarray) -> np.ndarray:
    """Overlaps counted pixel by pixel."""
    both = (gt[:, None] & pred).sum((2, 3))
    return both / np.maximum(1, (gt[:, None] | pred).sum((2, 3)))


def box_mask(box: list[int], size: int = 20) -> np.ndarray:
    mask = np.zeros((size, size), bool)
    mask[box[1] : box[3], box[0] : box[2]] = True
    return mask


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**31))
def test_boxes_are_masks(seed: int):
    rng = np.random.default_rng(seed)
    corners = np.sort(rng.integers(0, 20, (7, 2, 2)), axis=1)
    boxes = np.concatenate([corners[:, 0], corners[:, 1] + 1], axis=1)
    masks = np.stack([box_mask(box) for box in boxes.clip(max=20)])
    boxes = boxes.clip(max=20).astype(float)
    by_box = box_iou(boxes[:3], boxes[3:])
    by_mask = mask_iou(masks[:3], masks[3:])
    by_rle = rle_iou(encode_masks(masks[:3]), encode_masks(masks[3:]))
    # Ratios of the same whole numbers.
    np.testing.assert_array_equal(by_box, by_mask)
    np.testing.assert_array_equal(by_rle, by_mask)


def test_sequences_in_chunks_equal_frames_alone(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pairing, "_PAIRS_PER_CHUNK", 40)
    rng = np.random.default_rng(0)
    gt_frame, pred_frame = np.sort(rng.integers(0, 9, 60)), np.sort(rng.integers(2, 12, 50))
    corner = rng.random((110, 2)) * 10
    boxes = np.hstack([corner, corner + rng.random((110, 2)) * 5])
    gt_boxes, pred_boxes = boxes[:60], boxes[60:]
    row, column, iou = pair_boxes(gt_frame, gt_boxes, pred_frame, pred_boxes, 12)
    found = np.zeros((60, 50))
    found[row, column] = iou
    expected = box_iou(gt_boxes, pred_boxes) * (gt_frame[:, None] == pred_frame)
    np.testing.assert_array_equal(found, expected)
    assert np.all(np.diff(row * 50 + column) > 0)


@pytest.mark.usefixtures("unchecked_shapes")
def test_other_sizes_are_refused():
    small, large = np.ones((1, 4, 4), bool), np.ones((1, 4, 8), bool)
    with pytest.raises(SourceError, match="different sizes"):
        rle_iou(encode_masks(small), encode_masks(large))
