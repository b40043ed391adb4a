import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.crops import Crops
from remind_jax.formats.rows import boxes_of
from remind_jax.masks.relations import find_row_ends, relate_masks
from remind_jax.masks.run_length import encode_masks

FLOAT32_STEPS = 1e-4  # px; OpenCV adds up to 200 steps of 0.955 or 1.3693 in float32


def rectangle(left, top, right, bottom):
    mask = np.zeros((200, 300), bool)
    mask[top:bottom, left:right] = True
    return mask


def relate(masks, num_slots=None, **limits):
    masks = np.array(masks)
    boxes, areas = boxes_of(encode_masks(masks)), masks.sum(axis=(1, 2))
    ends = [find_row_ends(mask) if mask.any() else None for mask in masks]
    crops = Crops.of(masks)
    return relate_masks(crops, boxes, areas, ends, num_slots=num_slots or len(masks), **limits)


def chamfer_gap(one, other):
    """Least distance over all pairs of pixels, or minus the root of the shared pixels."""
    shared = np.count_nonzero(one & other)
    if shared:
        return -np.sqrt(shared)
    steps = np.abs(np.argwhere(one)[:, None] - np.argwhere(other)[None])
    most, least = steps.max(axis=-1), steps.min(axis=-1)
    return (0.955 * (most - least) + 1.3693 * least).min()


def test_gaps_of_the_page():
    a, b = rectangle(50, 50, 110, 100), rectangle(130, 60, 160, 90)  # method.md#example-relations
    inside, diagonal = rectangle(60, 60, 80, 80), rectangle(112, 102, 130, 120)
    far = rectangle(280, 0, 300, 30)
    found = relate([a, b, inside, diagonal, far])
    expected = [0, 21 * 0.955, -20, 3 * 1.3693]
    np.testing.assert_allclose(found.gap_px[0, :4], expected, atol=FLOAT32_STEPS)
    np.testing.assert_array_equal(found.exact[0], [False, True, True, True, False])
    # boxes 170 and 20 px apart
    assert found.gap_px[0, 4] == pytest.approx(np.hypot(170, 20))
    np.testing.assert_array_equal(found.touches_border, [False] * 4 + [True])


@st.composite
def shapes(draw):
    """A mask with several components, holes and bays."""
    mask = np.zeros((30, 40), bool)
    for filled in (True, True, False):
        left, top = draw(st.integers(0, 38)), draw(st.integers(0, 28))
        width, height = draw(st.integers(1, 25)), draw(st.integers(1, 20))
        mask[top : top + height, left : left + width] = filled
    return mask


@settings(max_examples=100, deadline=None)
@given(st.lists(shapes(), min_size=1, max_size=4))
def test_gap_is_the_least_chamfer_distance(masks):
    found = relate(masks, num_slots=5, scale_min_px=1000.0)  # everything is close
    np.testing.assert_array_equal(found.gap_px, found.gap_px.T)
    for i, one in enumerate(masks):
        for j, other in enumerate(masks):
            assert found.exact[i, j] == (i != j and one.any() and other.any())
            if found.exact[i, j]:
                expected = chamfer_gap(one, other)
                np.testing.assert_allclose(found.gap_px[i, j], expected, atol=FLOAT32_STEPS)
    edges = [mask[0].any() or mask[-1].any() or mask[:, [0, -1]].any() for mask in masks]
    np.testing.assert_array_equal(found.touches_border[: len(masks)], edges)
    padding = len(masks)
    assert not found.exact[padding:].any()
    assert not found.gap_px[padding:].any()


def test_limit_is_relative_to_the_size_of_the_masks():
    masks = [rectangle(0, 0, 100, 100), rectangle(200, 0, 300, 100)]  # one mean side apart
    near, far = relate(masks, exact_gap_max=1.0), relate(masks, exact_gap_max=0.99)
    assert near.exact[0, 1]
    assert not far.exact[0, 1]


def test_no_masks():
    found = relate_masks(np.zeros((0, 8, 8), bool), np.zeros((0, 4)), np.zeros(0), [], num_slots=2)
    assert found.gap_px.shape == (2, 2)
    assert not found.exact.any()
