"""Two small scenes and the settings that `golden/perception/switches.npz` was recorded with."""

from __future__ import annotations

import numpy as np

GRID, PATCH, DIM, HEADS = (9, 12), 16, 8, 3

_KMEANS, _ATTENTION = "part_descriptors.kmeans", "part_descriptors.attention"

# By the original's keys; every switch of the perception that it reads.
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
