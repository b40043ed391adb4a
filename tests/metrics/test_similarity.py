import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.errors import SourceError
from remind_jax.masks.run_length import encode_masks
from remind_jax.metrics.pairing import box_iou, rle_iou


def mask_iou(gt: np.ndarray, pred: np.ndarray) -> np.ndarray:
    """Overlaps counted pixel by pixel."""
    both = (gt[:, None] & pred).sum((2, 3))
    return both / np.maximum(1, (gt[:, None] | pred).sum((2, 3)))


def box_mask(box: list[int]) -> np.ndarray:
    mask = np.zeros((20, 20), bool)
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


@pytest.mark.usefixtures("unchecked_shapes")
def test_other_sizes_are_refused():
    small, large = np.ones((1, 4, 4), bool), np.ones((1, 4, 8), bool)
    with pytest.raises(SourceError, match="different sizes"):
        rle_iou(encode_masks(small), encode_masks(large))
