import jax
import numpy as np
import pytest

from remind_jax.config import Config
from remind_jax.masks.reduction import reduce_masks
from remind_jax.observation import FrameFeats
from remind_jax.remind.perception.description import describe
from remind_jax.remind.perception.ring_prototypes import find_ring_prototypes
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.perception import RingPrototypes
from remind_jax.static import Static
from tests.golden import load
from tests.solvers.on_host import cluster_points
from tests.statics import change_static, make_static

DESCRIBE = jax.jit(describe, static_argnames="static")
FIND = jax.jit(find_ring_prototypes, static_argnames="static")


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


def plain_prototypes(features, members, weights, seed, static: Static, t: RingPrototypes):
    """method.md#ring-prototypes for one ring: for each prototype all vectors as good as it."""
    inside = np.flatnonzero(members)
    if not len(inside):
        return []
    points = features[inside] / np.linalg.norm(features[inside], axis=1, keepdims=True)
    weights = weights[inside] if weights[inside].sum() > 1e-12 else np.ones(len(inside), np.float32)
    ideal = {
        "root": t.cluster_scale * np.sqrt(len(inside)),
        "patches": len(inside) / t.patches_per_cluster,
    }[static.switches.ring_cluster_rule]
    number = int(np.clip(np.round(ideal), *static.switches.ring_clusters))
    number = min(number, max(1, len(inside) // t.min_cluster_patches))
    if number == 1:
        return [[unit(points.mean(axis=0))]]
    labels, centers = cluster_points(
        points, number, static.switches.ring_iterations, static.switches.ring_restarts, seed
    )
    found = sorted(set(labels.tolist()))
    region = {cluster: cluster for cluster in found}
    for _ in found:
        for i in found:
            for j in found:
                if unit(centers[i]) @ unit(centers[j]) > t.joined:
                    region[i] = region[j] = min(region[i], region[j])
    regions = []
    for first in sorted(set(region.values())):
        clusters = [c for c in found if region[c] == first]
        own = np.concatenate([np.flatnonzero(labels == c) for c in clusters])
        center = unit(weights[own] @ points[own])
        cohesion = (points[own] @ center).mean()
        regions.append((weights[own].sum(), cohesion, own, center))
    total = sum(mass for mass, *_ in regions)
    regions = [r for r in regions if r[0] / total >= t.min_mass]
    regions.sort(key=lambda r: -r[0] * r[1] ** t.cohesion_power)
    regions = regions[: static.switches.ring_prototypes_kept or None]
    if static.switches.ring_prototype_kind == "centroid":
        return [[center] for *_, center in regions]
    # Two patches of equal weight are equally near to their mean.
    near = [(points[own] @ center, points[own]) for _, _, own, center in regions]
    return [own[cosine > cosine.max() - 1e-6] for cosine, own in near]


def unit(vector):
    return vector / np.linalg.norm(vector)


def random_rings(seed, num=12, grid=(12, 14), dim=6):
    """Maps of a few textures, and regions from one patch to half the map."""
    rng = np.random.default_rng(seed)
    textures = rng.standard_normal((5, dim))
    kind = rng.integers(0, 5, (grid[0] // 3, grid[1] // 3)).repeat(3, 0).repeat(3, 1)
    kind = np.pad(kind, ((0, grid[0] - kind.shape[0]), (0, grid[1] - kind.shape[1])))
    features = textures[kind] + 0.3 * rng.standard_normal((*grid, dim))
    features = features.reshape(-1, dim).astype(np.float32)
    share = rng.uniform(0.0, 0.5, (num, 2, 1)) ** 2
    rings = rng.random((num, 2, len(features))) < share
    rings[0, 0] = False
    weights = np.where(rings, rng.uniform(0.0, 1.0, rings.shape), 0.0).astype(np.float32)
    weights[1] = 0.0
    weights[2] = rings[2]
    return features, rings, weights


@pytest.mark.parametrize(
    ("settings", "rules"),
    [
        ({}, {}),
        ({"ring_prototypes_kept": 0, "ring_clusters": (2, 9)}, {"min_mass": 0.0, "joined": 0.8}),
        ({"ring_cluster_rule": "patches", "ring_prototype_kind": "centroid", "ring_seed": 5},
         {"patches_per_cluster": 6.0, "cohesion_power": 0.5, "min_cluster_patches": 2}),
    ],
)  # fmt: skip
def test_prototypes_equal_plain_lists(settings, rules):
    features, rings, weights = random_rings(len(settings))
    t = RingPrototypes(**rules)
    static = make_static(ring_prototypes=True, **settings)
    arrays = Thresholds(ring_prototypes=t).as_arrays(static.scalar).ring_prototypes
    found = FIND(features, rings, weights, static=static, t=arrays)
    vectors, valid = found.vector, found.valid
    sizes = set()
    for n, r in np.ndindex(rings.shape[:2]):
        seed = static.switches.ring_seed + r
        expected = plain_prototypes(features, rings[n, r], weights[n, r], seed, static, t)
        assert int(valid[n, r].sum()) == len(expected), (n, r)
        sizes.add(len(expected))
        for vector, equals in zip(vectors[n, r], expected, strict=False):
            # float32 sums over up to 80 patches in another order
            assert min(np.abs(vector - equal).max() for equal in equals) <= 2e-6, (n, r)
    assert len(sizes) > 2


def test_a_missing_ring_has_no_prototype():
    features, rings, weights = random_rings(0)
    static = make_static(ring_prototypes=True)
    arrays = Thresholds().as_arrays(static.scalar).ring_prototypes
    found = FIND(features, rings & False, weights * 0, static=static, t=arrays)
    assert not found.valid.any()
    assert not found.vector.any()


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
