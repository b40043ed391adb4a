import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.perception.parts import cluster_parts
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.perception import Perception
from remind_jax.solvers.clustering import cluster_points
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


@pytest.mark.parametrize(
    ("clusters", "labels", "centers"),
    [
        (2, [1, 1, 1, 1, 0], [[10, 0], [2, 0.5]]),
        (3, [1, 1, 2, 2, 0], [[10, 0], [0, 0.5], [4, 0.5]]),
    ],
)
def test_clustering_example_of_the_page(clusters, labels, centers):
    points = np.array([[0, 0], [0, 1], [4, 0], [4, 1], [10, 0]], np.float32)
    found, reached = cluster_points(points, clusters, iterations=5, restarts=2, seed=0)
    assert found.tolist() == labels
    np.testing.assert_allclose(reached, centers)


def test_parts_come_by_falling_support():
    parts, support, count = describe_parts(*of_directions((0, 8), (1, 10), (2, 6), (3, 9)))
    assert count == 4
    assert support.tolist() == [10, 9, 8, 6]
    assert parts.argmax(axis=1).tolist() == [1, 3, 0, 2]


def test_small_clusters_are_no_parts():
    _, support, count = describe_parts(*of_directions((0, 8), (1, 5), (2, 6)))
    assert count == 2
    assert support.tolist() == [8, 6, 0, 0]


def test_clusters_of_little_coverage_are_no_parts():
    features, coverage = of_directions((0, 8), (1, 8))
    coverage[:8] = 0.5
    _, support, count = describe_parts(features, coverage, part_min_support=4.5)
    assert count == 1
    assert support[0] == 8


def test_a_single_patch_is_a_part():
    parts, support, count = describe_parts(*of_directions((2, 1)))
    assert count == 1
    assert parts[0].argmax() == 2
    assert support[0] == 1


def test_two_to_five_patches_give_no_part():
    for num in range(2, 6):
        assert describe_parts(*of_directions((0, num)))[2] == 0


def test_one_cluster_is_one_part_whatever_its_size():
    features, coverage = of_directions((0, 1), (1, 2))
    one = make_static(part_clusters=1)
    parts, support, count = describe_parts(features, coverage, static=one)
    assert (count, support[0]) == (1, 3)
    np.testing.assert_allclose(parts[0], np.array([1, 2, 0, 0, 0]) / np.sqrt(5), atol=1e-6)


def test_no_patch_and_switched_off_give_no_part():
    features, coverage = of_directions((0, 20))
    for given_coverage, changes in ((0 * coverage, {}), (coverage, {"parts_enabled": False})):
        parts, support, count = describe_parts(features, given_coverage, **changes)
        assert count == 0
        assert not parts.any()
        assert not support.any()


def test_parts_are_pooled_from_raw_features_by_coverage():
    features, coverage = of_directions((0, 6))
    features[:6] = [[1, 0.1, 0, 0, 0]] * 3 + [[9, -0.9, 0, 0, 0]] * 3
    coverage[3:6] = 0.5
    one = make_static(part_clusters=1)
    parts, _, _ = describe_parts(features, coverage, static=one)
    mean = (3 * np.array([1, 0.1]) + 1.5 * np.array([9, -0.9])) / 4.5
    np.testing.assert_allclose(parts[0, :2], mean / np.linalg.norm(mean), atol=1e-6)


@pytest.mark.parametrize(("merge", "count"), [(0.59, 1), (0.61, 2)])
def test_a_part_like_a_stronger_one_is_dropped(merge, count):
    """The two directions have cosine 0.6; the survivor keeps its vector and its support."""
    features, coverage = of_directions((0, 10), (1, 7))
    features[10:17] = [0.6, 0.8, 0, 0, 0]
    parts, support, found = describe_parts(
        features, coverage, static=make_static(part_clusters=2), part_merge=merge
    )
    assert found == count
    assert support[0] == 10
    np.testing.assert_allclose(parts[0], [1, 0, 0, 0, 0], atol=1e-6)
