import jax
import numpy as np
import pytest

from remind_jax.config import Config
from remind_jax.masks.reduction import reduce_masks
from remind_jax.observation import FrameFeats
from remind_jax.remind.perception.description import describe
from remind_jax.remind.thresholds import Thresholds
from tests.golden import load
from tests.statics import change_static, make_static

DESCRIBE = jax.jit(describe, static_argnames="static")


@pytest.fixture(scope="module")
def recorded():
    """Values recorded from the original for eleven detections of three frames of `small`."""
    with np.load(load.ROOT / "perception" / "small.npz") as data:
        return dict(data)


@pytest.fixture(scope="module")
def described(recorded):
    """Our prototypes of the same detections: `[row, ring, prototype, D]`, and their validity."""
    static = change_static(Config().static, feature_dim=32, num_detections=5, ring_prototypes=True)
    rules, found = Thresholds().as_arrays(static.scalar), {}
    for index, (features, masks, classes) in enumerate(load.load_inputs("small")):
        if index in set(recorded["frame"].tolist()):
            reduced = reduce_masks(
                masks, np.zeros(len(classes)), np.ones(len(classes)),
                num_slots=5, patch_px=load.PATCH,
            )  # fmt: skip
            feats = FrameFeats(features, np.array(masks.shape[1:], np.int32))
            found[index] = DESCRIBE(feats, reduced, static=static, thresholds=rules)
    rows = [
        (found[frame], slot)
        for frame, slot in zip(recorded["frame"].tolist(), recorded["det"].tolist(), strict=True)
    ]
    vectors = np.stack([d.ring_prototypes.vector[slot] for d, slot in rows])
    return vectors, np.stack([d.ring_prototypes.valid[slot] for d, slot in rows])


def test_prototypes_equal_the_original(recorded, described):
    vectors, valid = described
    for ring, name in enumerate(("inner_prototypes", "outer_prototypes")):
        theirs = recorded[name]
        exists = np.isfinite(theirs).all(axis=-1)
        np.testing.assert_array_equal(valid[:, ring], exists)
        # a prototype is one patch, scaled to unit length in float32
        np.testing.assert_allclose(vectors[:, ring][exists], theirs[exists], atol=1e-6)


def test_nothing_is_described_unless_wanted():
    features, masks, classes = next(iter(load.load_inputs("small")))
    reduced = reduce_masks(
        masks, np.zeros(len(classes)), np.ones(len(classes)), num_slots=5, patch_px=load.PATCH
    )
    feats = FrameFeats(features, np.array(masks.shape[1:], np.int32))
    static = make_static(feature_dim=32, num_detections=5)
    shapes = jax.eval_shape(
        lambda: describe(feats, reduced, static, Thresholds().as_arrays(static.scalar))
    )
    assert shapes.ring_prototypes is None
