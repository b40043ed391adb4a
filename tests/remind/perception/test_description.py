import jax
import numpy as np
import pytest

from remind_jax.config import Config
from remind_jax.masks.reduction import reduce_masks
from remind_jax.observation import FrameFeats, Masks
from remind_jax.remind.perception.description import describe
from remind_jax.remind.perception.rings import INNER, OUTER
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.perception import Perception
from tests.golden import load
from tests.statics import change_static, make_static, only

GRID, DIM, SLOTS = (8, 10), 8, 3
STATIC = make_static(num_detections=SLOTS, feature_dim=DIM)
GLOBAL, TRIMMED = 0, 1
DESCRIBE = jax.jit(describe, static_argnames="static")


def describe_frame(features, coverage, filled=None, **changes):
    coverage = np.asarray(coverage, np.float32)
    num = len(coverage)
    masks = only(
        Masks,
        coverage=coverage,
        filled_coverage=coverage if filled is None else np.asarray(filled, np.float32),
        quality=np.ones(num),
        class_id=np.arange(num, dtype=np.int32),
        valid=coverage.any(axis=(1, 2)),
    )
    return describe_masks(features, masks, **changes)


def describe_masks(features, masks, static=STATIC, **changes):
    rules = Thresholds(perception=Perception(**changes)).as_arrays(static.scalar)
    feats = FrameFeats(features, np.array([16 * n for n in features.shape[:2]], np.int32))
    return jax.tree.map(np.asarray, DESCRIBE(feats, masks, static=static, thresholds=rules))


def random_features():
    return np.random.default_rng(0).standard_normal((*GRID, DIM)).astype(np.float32)


def one_block(value=1.0):
    coverage = np.zeros((SLOTS, *GRID), np.float32)
    coverage[0, 2:6, 3:7] = value
    return coverage


@pytest.fixture(scope="module")
def recorded():
    """Values recorded from the original for eleven detections of three frames of `small`."""
    with np.load(load.ROOT / "perception" / "small.npz") as data:
        return dict(data)


@pytest.fixture(scope="module")
def described(recorded):
    """Our descriptors of the same detections: a list over rows of (descriptors, slot)."""
    frames = {int(frame) for frame in recorded["frame"]}
    config, found = Config(), {}
    static = change_static(config.static, feature_dim=32, num_detections=5, ring_prototypes=True)
    for index, (features, masks, classes) in enumerate(load.load_inputs("small")):
        if index in frames:
            reduced = reduce_masks(
                masks, np.zeros(len(classes)), np.ones(len(classes)),
                num_slots=5, patch_px=load.PATCH,
            )  # fmt: skip
            found[index] = describe_masks(features, reduced, static)
    rows = zip(recorded["frame"], recorded["det"], strict=True)
    return [(found[int(frame)], int(slot)) for frame, slot in rows]


@pytest.mark.parametrize(
    ("name", "field", "channel"),
    [
        ("global", "appearance", GLOBAL),
        ("trimmed", "appearance", TRIMMED),
        ("inner", "rings", INNER),
        ("outer", "rings", OUTER),
    ],
)
def test_vectors_equal_the_original(recorded, described, name, field, channel):
    ours = np.stack([getattr(d, field)[slot, channel] for d, slot in described])
    # float32 sums over up to 200 patches in another order
    np.testing.assert_allclose(ours, recorded[name], atol=1e-6)


def test_parts_equal_the_original(recorded, described):
    for row, (d, slot) in enumerate(described):
        vectors = recorded["part_vectors"][row]
        exists = np.isfinite(vectors).all(axis=1)
        assert d.parts_valid[slot, 0].tolist() == exists.tolist()
        np.testing.assert_allclose(d.parts[slot, 0][exists], vectors[exists], atol=1e-6)
        support = np.nansum(recorded["part_support"][row])
        np.testing.assert_allclose(d.part_support[slot], support, rtol=1e-6)


@pytest.mark.parametrize("ring", [INNER, OUTER])
def test_ring_prototypes_equal_the_original(recorded, described, ring):
    theirs = recorded[{INNER: "inner_prototypes", OUTER: "outer_prototypes"}[ring]]
    exists = np.isfinite(theirs).all(axis=-1)
    ours, valid = (
        np.stack([getattr(d.ring_prototypes, name)[slot, ring] for d, slot in described])
        for name in ("vector", "valid")
    )
    np.testing.assert_array_equal(valid, exists)
    # a prototype is one patch, scaled to unit length in float32
    np.testing.assert_allclose(ours[exists], theirs[exists], atol=1e-6)


def test_padding_is_described_by_nothing():
    d = describe_frame(random_features(), one_block())
    assert d.ring_prototypes is None, "they were not asked for"
    assert d.valid.tolist() == [True, False, False]
    for leaf in (d.appearance, d.parts, d.rings, d.patch_sum, d.num_patches, d.ring_patches):
        assert not leaf[1:].any()
    for leaf in (d.appearance_valid, d.parts_valid, d.rings_valid):
        assert not leaf[1:].any()


def test_patches_of_small_coverage_do_not_count_above_a_threshold():
    features, coverage = random_features(), one_block(value=0.2)
    coverage[0, 3, 4] = 0.25
    coverage[0, 4, 4] = 0.5
    d = describe_frame(features, coverage, patch_coverage=0.25)
    unit = features[4, 4] / np.linalg.norm(features[4, 4])
    np.testing.assert_allclose(d.appearance[0, GLOBAL], unit, atol=1e-6)
    assert d.num_patches[0] == 1
    np.testing.assert_allclose(d.patch_sum[0], 14 * 0.2 + 0.75, rtol=1e-6)  # all of the mask


def test_detection_without_any_selected_patch_is_valid_but_undescribed():
    d = describe_frame(random_features(), one_block(value=0.2), patch_coverage=0.25)
    assert d.valid[0]
    assert not d.appearance_valid[0].any()
    assert not d.parts_valid[0].any()
    assert d.num_patches[0] == 0
    assert d.patch_sum[0] > 0


def test_parts_can_be_switched_off():
    for is_on in (True, False):
        d = describe_frame(random_features(), one_block(), part_min_patches=1, parts_enabled=is_on)
        assert d.parts_valid[0].any() == is_on
        assert d.parts.any() == is_on


def test_rings_lie_around_the_filled_mask():
    """An L whose filled mask also covers the corner: the corner is no background."""
    coverage, filled = one_block(), one_block()
    coverage[0, 2:4, 5:7] = 0
    plain = describe_frame(random_features(), coverage)
    around = describe_frame(random_features(), coverage, filled)
    whole = describe_frame(random_features(), filled)
    np.testing.assert_array_equal(around.rings[0], whole.rings[0])
    assert (around.ring_patches[0] != plain.ring_patches[0]).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_bad_patches_are_left_out_everywhere(bad):
    features, coverage = random_features(), one_block()
    clean = coverage.copy()
    clean[0, 2, 3] = 0
    spoiled = features.copy()
    spoiled[2, 3, 5] = spoiled[0, 0, 0] = bad  # one of the object, one of the background
    d = describe_frame(spoiled, coverage)
    assert int(d.num_bad_patches) == 2
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(d))
    expected = describe_frame(features, clean, coverage)
    np.testing.assert_array_equal(d.appearance, expected.appearance)
    np.testing.assert_array_equal(d.parts, expected.parts)
    assert d.num_patches[0] == 15
    assert d.ring_patches[0].sum() == expected.ring_patches[0].sum() - 1
    assert d.valid[0]
