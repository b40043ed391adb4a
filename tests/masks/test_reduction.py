import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.crops import Crops
from remind_jax.masks.reduction import patch_coverage, reduce_masks
from tests.golden import load

PATCH = 8


def reduce(*masks, slots=None, **options):
    stacked = np.array(masks, bool)
    num = len(stacked)
    return reduce_masks(
        stacked, np.arange(num), np.full(num, 0.5), num_slots=slots or num, patch_px=PATCH,
        **options,
    )  # fmt: skip


def blank(height=40, width=48):
    return np.zeros((height, width), bool)


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    patch=st.sampled_from([2, 4, 8, 14, 16]),
    extra=st.tuples(st.integers(0, 13), st.integers(0, 13)),
)
def test_coverage_is_the_area_resize(seed, patch, extra):
    """As the original computes it: OpenCV's area resize of the cropped mask."""
    rng = np.random.default_rng(seed)
    mask = rng.random((3 * patch + extra[0] % patch, 5 * patch + extra[1] % patch)) < rng.random()
    expected = cv2.resize(
        mask[: 3 * patch, : 5 * patch].astype(np.float32), (5, 3), interpolation=cv2.INTER_AREA
    )
    found = patch_coverage(cv2.integral(mask.view(np.uint8)), patch)
    assert found.dtype == np.float32
    # exact where the patch area is a power of two; elsewhere a last bit of float32
    np.testing.assert_allclose(found, expected, atol=0 if patch in (2, 4, 8, 16) else 1e-6)


@st.composite
def frames(draw):
    """Up to four masks of rectangles and holes, some of them frayed, some of them empty."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    masks = np.zeros((rng.integers(1, 5), *rng.integers(16, 90, 2)), bool)
    for mask in masks:
        for _ in range(rng.integers(0, 5)):
            top, left = (rng.integers(0, side) for side in mask.shape)
            height, width = rng.integers(1, 40, 2)
            mask[top : top + height, left : left + width] = rng.random() < 0.7
        if rng.random() < 0.3:
            mask &= rng.random(mask.shape) < rng.random()
    return masks


def reduce_on_whole_frames(
    masks, *, patch_px, sanitize, fill_holes, close_px, open_px, keep_largest, erosion_px
):
    """Coverage, filled coverage, quality, box, center, area and validity of every mask.

    Reduced plainly, with every operation on the whole frame: what the quick way must equal.
    """
    masks = np.asarray(Crops.of(masks).eroded(erosion_px, margin_px=0))
    rows = []
    for mask in masks:
        pixels = mask.view(np.uint8)
        grid = cover(pixels, patch_px)
        if not mask.any():
            rows.append((grid, grid, 0.0, np.zeros(4), np.zeros(2), 0, False))
            continue
        y, x = mask.nonzero()
        box = np.array([x.min(), y.min(), x.max() + 1, y.max() + 1], float)
        center = box[0] + (x - x.min()).sum() / len(x), box[1] + (y - y.min()).sum() / len(y)
        solid = largest_piece(pixels) if keep_largest and sanitize != "none" else pixels
        filled = fill(solid, sanitize, fill_holes, close_px, open_px)
        num_filled = int(filled.sum())
        quality = min(1.0, 1.0 - max(0, num_filled - len(x)) / max(1, num_filled))
        filled_grid = cover(filled, patch_px)
        rows.append((grid, filled_grid, quality, box, np.array(center), len(x), True))
    return [np.array(values) for values in zip(*rows, strict=True)]


def cover(pixels, patch_px):
    height, width = (side // patch_px for side in pixels.shape)
    whole = pixels[: height * patch_px, : width * patch_px]
    counts = whole.reshape(height, patch_px, width, patch_px).sum(axis=(1, 3), dtype=np.int64)
    return (counts * np.float32(1.0 / patch_px**2)).astype(np.float32)


def largest_piece(pixels):
    _, labels, stats, _ = cv2.connectedComponentsWithStats(pixels, connectivity=8)
    return (labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])).astype(np.uint8)


def fill(pixels, mode, fill_holes, close_px, open_px):
    if mode == "none":
        return pixels
    if mode == "convex_hull":
        filled = np.zeros_like(pixels)
        cv2.fillConvexPoly(filled, cv2.convexHull(cv2.findNonZero(pixels)), 1)
        return filled
    filled = pixels
    if fill_holes:
        flooded = np.pad(pixels, 1)
        cv2.floodFill(flooded, None, (0, 0), 2, flags=4)
        filled = np.ascontiguousarray((flooded != 2).astype(np.uint8)[1:-1, 1:-1])
    for side, operation in ((close_px, cv2.MORPH_CLOSE), (open_px, cv2.MORPH_OPEN)):
        if side > 0:
            filled = cv2.morphologyEx(filled, operation, np.ones((side, side), np.uint8))
    return filled


@settings(max_examples=200, deadline=None)
@given(
    masks=frames(),
    patch_px=st.sampled_from([2, 4, 7, 8, 14, 16]),
    sanitize=st.sampled_from(["convex_hull", "morphology", "none"]),
    fill_holes=st.booleans(),
    close_px=st.integers(0, 5),
    open_px=st.integers(0, 3),
    keep_largest=st.booleans(),
    erosion_px=st.integers(0, 2),
)
def test_nothing_is_lost_by_looking_at_the_boxes_only(masks, **options):
    num = len(masks)
    found = reduce_masks(masks, np.arange(num), np.ones(num), num_slots=num, **options)
    fields = ("coverage", "filled_coverage", "quality", "box", "center", "area", "valid")
    for name, expected in zip(fields, reduce_on_whole_frames(masks, **options), strict=True):
        np.testing.assert_array_equal(getattr(found, name), expected, err_msg=name)


def test_values_equal_the_original():
    """Coverage, hull, box, center and solidity recorded for three frames of `small`."""
    with np.load(load.ROOT / "perception" / "small.npz") as data:
        recorded = dict(data)
    frames = list(load.load_inputs("small"))
    for row, (frame, det) in enumerate(zip(recorded["frame"], recorded["det"], strict=True)):
        masks = frames[frame].masks
        found = reduce_masks(
            masks, np.zeros(len(masks)), np.ones(len(masks)),
            num_slots=len(masks), patch_px=load.PATCH,
        )  # fmt: skip
        np.testing.assert_array_equal(found.coverage[det] * 256, recorded["coverage"][row])
        np.testing.assert_array_equal(
            found.filled_coverage[det] * 256, recorded["hull_coverage"][row]
        )
        assert found.box[det].tolist() == recorded["bbox"][row].tolist()
        np.testing.assert_allclose(found.center[det], recorded["center"][row], rtol=1e-14)
        assert found.area[det] == recorded["area"][row]
        assert found.quality[det] == recorded["mask_quality"][row]


def test_an_empty_mask_is_no_detection():
    mask = blank()
    mask[:8, :8] = True
    found = reduce(blank(), mask, slots=4)
    assert found.valid.tolist() == [False, True, False, False]
    for leaf in (found.coverage, found.filled_coverage, found.quality, found.box, found.area):
        assert not leaf[[0, 2, 3]].any()

    nothing = np.zeros((0, 40, 48), bool)
    found = reduce_masks(nothing, np.zeros(0), np.zeros(0), num_slots=3, patch_px=PATCH)
    assert found.coverage.shape == (3, 5, 6)
    assert not found.valid.any()


@pytest.mark.parametrize("radius", [0, 1, 3])
def test_erosion_spares_what_touches_the_box(radius):
    """method.md#mask-geometry: all 36 pixels of a full square survive."""
    mask = blank(16, 16)
    mask[4:10, 5:11] = True
    reduced = reduce(mask, erosion_px=radius)
    assert reduced.area[0] == 36
    np.testing.assert_array_equal(reduced.box[0], [5, 4, 11, 10])
