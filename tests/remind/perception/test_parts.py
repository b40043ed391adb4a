import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.remind.perception.parts import cluster_parts
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.perception import Perception
from tests.statics import make_static

STATIC = make_static(part_clusters=4, part_iterations=5, part_restarts=2)
NUM_PATCHES, DIM = 40, 5
CLUSTER = jax.jit(cluster_parts, static_argnames="static")


def describe_parts(features, coverage, static=STATIC, **changes):
    """Parts of one detection as arrays of their own length."""
    rules = Thresholds(perception=Perception(**changes)).as_arrays(jnp.float32).perception
    coverage = np.asarray(coverage, np.float32)[None]
    features = np.asarray(features, np.float32)
    parts, valid, support = CLUSTER(features, coverage, coverage > 0, static=static,
                                    thresholds=rules)  # fmt: skip
    valid = np.asarray(valid[0])
    assert not valid[valid.sum() :].any(), "existing parts come first"
    return np.asarray(parts[0]), np.asarray(support[0]), int(valid.sum())


def of_directions(*groups):
    """Unit features in given directions: (axis, number of patches) per group; coverage 1."""
    axes = [axis for axis, count in groups for _ in range(count)]
    features = np.zeros((NUM_PATCHES, DIM), np.float32)
    features[np.arange(len(axes)), axes] = 1.0
    return features, (np.arange(NUM_PATCHES) < len(axes)).astype(np.float32)


def test_two_to_five_patches_give_no_part():
    for num in range(2, 6):
        assert describe_parts(*of_directions((0, num)))[2] == 0


def test_no_patch_and_switched_off_give_no_part():
    features, coverage = of_directions((0, 20))
    for given_coverage, changes in ((0 * coverage, {}), (coverage, {"parts_enabled": False})):
        parts, support, count = describe_parts(features, given_coverage, **changes)
        assert count == 0
        assert not parts.any()
        assert not support.any()
