import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from remind_jax.detectors import DetectorOptions, DropCounts
from remind_jax.detectors.refinement import erode_masks, refine_detections
from remind_jax.frame import Detections


def square(size: int, top: int, left: int, shape: tuple[int, int] = (20, 30)) -> np.ndarray:
    mask = np.zeros(shape, bool)
    mask[top : top + size, left : left + size] = True
    return mask


def test_radius_two_takes_two_pixels_from_every_side():
    (eroded,) = erode_masks(square(7, 5, 6)[None], 2)
    np.testing.assert_array_equal(eroded, square(3, 7, 8))


def test_the_image_border_does_not_erode():
    whole = np.ones((1, 9, 9), bool)
    assert erode_masks(whole, 2).all()
    (corner,) = erode_masks(square(7, 0, 0)[None], 2)
    np.testing.assert_array_equal(corner, square(5, 0, 0))


@settings(deadline=None)
@given(
    masks=hnp.arrays(bool, st.tuples(st.integers(0, 3), st.integers(1, 14), st.integers(1, 14))),
    radius=st.integers(0, 4),
)
def test_erosion_equals_scipy_with_a_foreground_outside(masks, radius):
    window = np.ones((2 * radius + 1,) * 2, bool)
    expected = [ndimage.binary_erosion(mask, window, border_value=1) for mask in masks]
    np.testing.assert_array_equal(erode_masks(masks, radius), np.reshape(expected, masks.shape))


def test_every_drop_is_counted_by_its_reason_and_the_order_stays():
    detections = Detections.create(
        np.stack(
            [
                square(7, 5, 6),  # 9 pixels left
                square(4, 2, 2),  # eroded away
                square(0, 0, 0),  # empty from the start
                square(5, 8, 8),  # 1 pixel left: too small
                square(9, 8, 8),  # 25 pixels left
                square(9, 0, 9),  # ignored class
                square(9, 0, 9),  # score too low
            ]
        ),
        labels=["cup", "cup", "cup", "cup", "chair", "Wall", "cup"],
        scores=[0.5, 0.9, 0.9, 0.9, 0.8, 0.9, 0.2],
    )
    options = DetectorOptions(min_mask_px=2, ignored_classes=("wall",))
    kept, drops = refine_detections(detections, options)
    assert kept.labels == ("cup", "chair")
    assert kept.scores.tolist() == [np.float32(0.5), np.float32(0.8)]
    assert kept.masks.sum(axis=(1, 2)).tolist() == [9, 25]
    assert drops == DropCounts(empty=1, eroded=1, small=1)
    assert (drops + drops).total == 6


def test_no_detections_stay_none():
    kept, drops = refine_detections(Detections.empty(4, 6), DetectorOptions())
    assert kept.masks.shape == (0, 4, 6)
    assert drops.total == 0
