"""Settings that several keys of the original decide together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

# Every key that is read here, with the value that the original ships.
SHIPPED: dict[str, Any] = {
    "dino.patch_selection": "any",
    "dino.patch_threshold": 0.0,
    "davis.mask_erosion_px": 0,
    "davis.mask_erosion_iters": 1,
    "object_features.global.enabled": True,
    "object_features.global_trimmed.enabled": True,
    "part_descriptors.enabled": True,
    "part_descriptors.kmeans.enabled": True,
    "part_descriptors.kmeans.merge.enabled": True,
    "part_descriptors.kmeans.merge.mode": "keep_best",
    "part_descriptors.attention.enabled": False,
    "part_descriptors.attention.head_ids": None,
    "bg_local.sanitize.enabled": True,
    "bg_local.sanitize.mode": "convex_hull",
    "bg_local.prototypes.enabled": True,
    "memory.appearance.enabled": True,
    "memory.appearance.channels.global.enabled": True,
    "memory.appearance.channels.global_trimmed.enabled": True,
    "memory.appearance.channels.patch.enabled": False,
    "memory.parts.enabled": True,
    "memory.parts.channels.kmeans.enabled": True,
    "memory.parts.channels.attention.enabled": True,
    "memory.background.enabled": True,
    "association.similarity.background_partials.enabled": False,
    "association.scores.neighbor_sets.context.k": 6,
    "association.matching.neighbor_sets_context_veto.local.expected_topk_scale": 2.0,
    "update.background_memory.enabled": True,
}

# Values of keys that are no gates.
CHOICES: dict[str, tuple[str, ...]] = {
    "dino.patch_selection": ("any", "threshold"),
    "part_descriptors.kmeans.merge.mode": ("keep_best", "weighted_mean"),
    "bg_local.sanitize.mode": ("convex_hull", "morphology"),
}


def decide(given: Mapping[str, Any]) -> dict[str, Any]:
    """Turns these keys of the original into settings of this package.

    Args:
      given: Values by key; keys that are not among `SHIPPED` are not looked at.
    """
    get = lambda key: given.get(key, SHIPPED[key])  # noqa: E731
    by_threshold = get("dino.patch_selection") == "threshold"
    erosion_px = get("davis.mask_erosion_px") * max(1, get("davis.mask_erosion_iters"))
    return {
        "thresholds.perception.patch_coverage": (
            float(get("dino.patch_threshold")) if by_threshold else 0.0
        ),
        "input.erosion_px": max(0, erosion_px),
        "input.sanitize": (
            get("bg_local.sanitize.mode") if get("bg_local.sanitize.enabled") else "none"
        ),
        "static.ring_prototypes": get("bg_local.prototypes.enabled")
        and get("association.similarity.background_partials.enabled"),
        "thresholds.background.enabled": get("memory.background.enabled")
        and get("update.background_memory.enabled"),
        **_neighbors(get),
        **_appearance(get),
        **_parts(get),
    }


def _neighbors(get: Any) -> dict[str, Any]:
    """The list of expected neighbors is some times as long as the list of hypotheses."""
    listed = max(1, get("association.scores.neighbor_sets.context.k"))
    scale = get("association.matching.neighbor_sets_context_veto.local.expected_topk_scale")
    return {
        "static.context_hypotheses": listed,
        "static.expected_neighbours": max(listed, math.ceil(listed * scale)),
    }


def _appearance(get: Any) -> dict[str, Any]:
    """A descriptor counts if it is both computed and remembered."""
    kept = _channels(get, "memory.appearance", ("global", "global_trimmed", "patch"))
    return {
        "thresholds.perception.global_enabled": kept["global"]
        and get("object_features.global.enabled"),
        "thresholds.perception.trimmed_enabled": kept["global_trimmed"]
        and get("object_features.global_trimmed.enabled"),
    }


def _parts(get: Any) -> dict[str, Any]:
    kept = _channels(get, "memory.parts", ("kmeans", "attention"))
    sources = [name for name in ("kmeans", "attention") if get(f"part_descriptors.{name}.enabled")]
    joins = get("part_descriptors.kmeans.merge.mode") == "weighted_mean"
    merges = get("part_descriptors.kmeans.merge.enabled")
    resembling = ("join" if joins else "drop") if merges else "keep"
    return {
        "static.part_source": "both" if len(sources) == 2 else (sources or ["kmeans"])[0],
        "static.part_resembling": resembling,
        "static.attention_heads": tuple(get("part_descriptors.attention.head_ids") or ()),
        "thresholds.perception.parts_enabled": get("part_descriptors.enabled") and bool(sources),
        "thresholds.perception.kmeans_parts_kept": kept["kmeans"],
        "thresholds.perception.attention_parts_kept": kept["attention"],
    }


def _channels(get: Any, section: str, names: tuple[str, ...]) -> dict[str, bool]:
    """Which channels of a memory exist; one without any channel gets them all."""
    chosen = {name: get(f"{section}.channels.{name}.enabled") for name in names}
    none = not any(chosen.values())
    return {name: get(f"{section}.enabled") and (none or chosen[name]) for name in names}
