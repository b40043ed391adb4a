"""Every switch of the perception, against values recorded from the original."""

import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.config import Config
from remind_jax.config.dotted_keys import nest
from remind_jax.errors import ConfigError
from remind_jax.masks.reduction import reduce_masks
from remind_jax.observation import FrameFeats, PatchAttention
from remind_jax.remind.perception.description import describe
from tests.golden import load
from tests.statics import change_static

GRID, PATCH, DIM, HEADS = (9, 12), 16, 8, 3

_KMEANS, _ATTENTION = "part_descriptors.kmeans", "part_descriptors.attention"

# What was recorded with, by the original's keys; every switch of the perception that it reads.
SETTINGS: dict[str, dict] = {
    "shipped": {},
    "unweighted": {
        "object_features.global.weighted": False,
        "object_features.global_trimmed.weighted": False,
        f"{_KMEANS}.weighted": False,
        f"{_ATTENTION}.enabled": True,
        f"{_ATTENTION}.weighted": False,
    },
    "weighted apart": {
        "object_features.global.weighted": False,
        f"{_KMEANS}.merge.enabled": False,
        "bg_local.sanitize.enabled": False,
    },
    "disabled": {
        "object_features.global.enabled": False,
        "object_features.patch.enabled": False,
        f"{_KMEANS}.enabled": False,
        f"{_ATTENTION}.enabled": True,
    },
    "trimmed parts": {
        "object_features.global_trimmed.enabled": False,
        f"{_KMEANS}.use_trimmed_mean": True,
        f"{_KMEANS}.trimmed_keep_frac": 0.4,
        f"{_KMEANS}.trimmed_min_patches": 5,
        f"{_KMEANS}.min_cluster_patches": 2,
        f"{_ATTENTION}.enabled": True,
        f"{_ATTENTION}.use_trimmed_mean": True,
        f"{_ATTENTION}.trimmed_min_patches": 3,
        "bg_local.sanitize.keep_largest_component": True,
    },
    "trimmed unweighted parts": {
        f"{_KMEANS}.use_trimmed_mean": True,
        f"{_KMEANS}.trimmed_min_patches": 3,
        f"{_KMEANS}.weighted": False,
        f"{_KMEANS}.k": 2,
        "bg_local.sanitize.mode": "morphology",
        "bg_local.sanitize.fill_holes": False,
        "bg_local.sanitize.open_px": 5,
    },
    "joined parts": {
        f"{_KMEANS}.merge.mode": "weighted_mean",
        f"{_KMEANS}.merge.sim_thr": 0.3,
        f"{_KMEANS}.min_cluster_patches": 2,
        f"{_KMEANS}.min_support": 1.5,
        "bg_local.sanitize.mode": "morphology",
        "bg_local.sanitize.keep_largest_component": True,
    },
    "attention": {
        f"{_ATTENTION}.enabled": True,
        f"{_ATTENTION}.head_ids": [0, 2],
        f"{_ATTENTION}.seed_score": "out_degree",
        f"{_ATTENTION}.max_seeds": 4,
        f"{_ATTENTION}.region_frac": 0.5,
        f"{_ATTENTION}.max_region_frac": 0.4,
        f"{_ATTENTION}.min_region_patches": 3,
    },
}


def make_scene(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features `[Hp, Wp, D]`, masks `[5, H, W]`, attention `[heads, P, P]`; exact numbers only."""
    rng = np.random.default_rng(seed)
    rows, columns = GRID
    textures = rng.integers(-64, 64, (5, DIM)) / 32
    kind = rng.integers(0, 5, (rows // 3, columns // 2)).repeat(3, 0).repeat(2, 1)
    features = textures[kind] + rng.integers(-64, 64, (rows, columns, DIM)) / 64
    masks = np.zeros((5, rows * PATCH, columns * PATCH), bool)
    masks[0, 8:90, 20:110] = True  # hollow, with a second piece
    masks[0, 40:60, 50:80] = False
    masks[0, 110:120, 150:160] = True
    masks[1, 100:131, 100:116] = True  # an L
    masks[1, 115:131, 100:150] = True
    masks[2, 33:40, 130:139] = True  # a dot
    masks[3, 5:60, 120:190] = True
    masks[3, 30:33, 120:190] = False  # cut by a slit
    masks[4, 60:100, 0:30] = True
    masks[4, 75:76, 29:30] = False
    num = rows * columns
    attention = rng.integers(1, 2**12, (HEADS, num, num)) / 2**19  # rows sum to less than 1
    return features.astype(np.float32), masks, attention.astype(np.float32)


DESCRIBE = jax.jit(describe, static_argnames="static")
NUM_SCENES = 2
SPARE_SLOTS = 3  # of the attention, so that padding is tried


@pytest.fixture(scope="module")
def recorded():
    with np.load(load.ROOT / "perception" / "switches.npz") as data:
        rows = zip(data["names"].tolist(), data["vectors"], data["numbers"], strict=True)
        return {name: (vectors, numbers) for name, vectors, numbers in rows}


def attention_of(masks, attention) -> PatchAttention:
    """What a backbone would say of the patches of all objects."""
    patches = np.flatnonzero(masks.coverage.any(axis=0))
    slots = np.full(len(patches) + SPARE_SLOTS, -1, np.int32)
    slots[: len(patches)] = patches
    sums = np.zeros(len(slots), np.float32)
    block = np.zeros((len(slots), len(slots)), np.float32)
    sums[: len(patches)] = attention.sum(axis=1)[patches]
    block[: len(patches), : len(patches)] = attention[np.ix_(patches, patches)]
    return PatchAttention(slots, sums, block)


def describe_scene(seed: int, settings: dict, **more):
    features, masks, attention = make_scene(seed)
    config = Config.from_reference(nest(settings))
    options = config.input
    reduced = reduce_masks(
        masks, np.zeros(len(masks)), np.ones(len(masks)), num_slots=len(masks) + 1,
        patch_px=PATCH, sanitize=options.sanitize, fill_holes=options.fill_holes,
        close_px=options.close_px, open_px=options.open_px, keep_largest=options.keep_largest,
    )  # fmt: skip
    static = dataclasses.replace(
        config.static, feature_dim=DIM, num_detections=len(masks) + 1, **more
    )
    heads = list(static.switches.attention_heads) or slice(None)
    known = None
    if static.switches.part_source != "kmeans":
        known = attention_of(reduced, attention[heads].mean(axis=0))
    size = np.array([PATCH * side for side in GRID], np.int32)
    rules = config.thresholds.as_arrays(static.scalar)
    feats = FrameFeats(features, size, known)
    found = DESCRIBE(feats, reduced, static=static, thresholds=rules)
    return jax.tree.map(np.asarray, found), static


@pytest.mark.parametrize("name", SETTINGS)
def test_descriptors_equal_the_original(recorded, name):
    for seed in range(NUM_SCENES):
        d, static = describe_scene(seed, SETTINGS[name])
        num = sum(key.startswith(f"{seed}/{name}/") for key in recorded)
        for i in range(num):
            vectors, numbers = recorded[f"{seed}/{name}/{i}"]
            ours = [
                np.where(d.appearance_valid[i][:, None], d.appearance[i], np.nan),
                np.where(d.rings_valid[i][:, None], d.rings[i], np.nan),
            ]
            for channel in ("kmeans", "attention"):
                parts = np.full((4, DIM), np.nan)
                if channel in static.switches.part_channels:
                    c = static.switches.part_channels.index(channel)
                    most = d.parts.shape[2]
                    parts[:most][d.parts_valid[i, c]] = d.parts[i, c][d.parts_valid[i, c]]
                ours.append(parts)
            # float32 sums over up to 60 patches in another order
            where = f"{name}, scene {seed}, mask {i}"
            np.testing.assert_allclose(np.concatenate(ours), vectors, atol=2e-6, err_msg=where)
            count, quality, inner, outer, *support = numbers
            assert d.num_patches[i] == count, where
            np.testing.assert_allclose(d.mask_quality[i], quality, rtol=1e-6)
            assert d.ring_patches[i].tolist() == [inner, outer], where
            kmeans, attention = sum(support[:4]), sum(support[4:])
            np.testing.assert_allclose(d.part_support[i], max(kmeans, attention), rtol=1e-6)
            exists = np.isfinite(vectors[4:]).all(axis=1).reshape(2, 4).sum(axis=1)
            assert d.num_parts[i] == exists.max(), where


def test_attention_must_come_with_the_frame():
    features, masks, _ = make_scene(0)
    reduced = reduce_masks(masks, np.zeros(5), np.ones(5), num_slots=5, patch_px=PATCH)
    static = change_static(Config().static, feature_dim=DIM, part_source="attention")
    feats = FrameFeats(features, np.array([144, 192], np.int32))
    with pytest.raises(ConfigError, match="without attention"):
        DESCRIBE(
            feats, reduced, static=static, thresholds=Config().thresholds.as_arrays(static.scalar)
        )
