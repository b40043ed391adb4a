"""Settings of the original implementation, read as settings of this package."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from remind_jax.config.dotted_keys import flatten, nest
from remind_jax.errors import ConfigError, nearest_names
from remind_jax.settings.ranges import check_range
from remind_jax.settings.record import Setting, walk_settings

_SETS = "association.scores.neighbor_sets"
_DISTANCES = "association.ambiguous_tracks.known_set_distance_disambiguation"

# Keys that are supported with this value only.
FIXED: dict[str, Any] = {
    f"{_SETS}.candidate_pair_matrix.enabled": True,
    f"{_SETS}.candidate_pair_matrix.max_objects": 160,
    f"{_SETS}.options.det_combo_max": 32,
    f"{_SETS}.options.det_variants": 2,
    f"{_SETS}.options.obj_variants": 2,
    # Without these every observation is kept for ever, and memory has no bound.
    "update.appearance_memory.enabled": True,
    "update.parts_memory.enabled": True,
}

# Keys, or whole sections, that never change an identity in a supported setting.
INERT: tuple[str, ...] = (
    "runtime",
    "timing",
    "paths",
    "input",
    "detector.backend",
    "yolo",
    "davis",
    "dino.model_label",
    "dino.models",
    "dino.default_patch_size",
    "dino.normalize_embeddings",
    "dino.patch_coverage_mode",
    "object_features.patch.return_coverage",
    "object_features.patch.l2_normalize",
    "part_descriptors.attention.return_masks",
    "part_descriptors.kmeans.return_masks",
    "bg_local.combine_weights",
    "memory.neighbors_distance.var_floor",
    f"{_SETS}.max_class_options",
    f"{_SETS}.density_factor",
    f"{_SETS}.core.selective_classes",
    f"{_SETS}.context.enabled",
    f"{_SETS}.context.min_p",
    f"{_SETS}.context.gamma",
    f"{_SETS}.context.maturity_tau",
    f"{_SETS}.beam_state_mode",
    "association.matching.neighbor_sets_context_veto.local.require_supported_alternative",
    f"{_DISTANCES}.min_core_assignment_score",
    f"{_DISTANCES}.min_core_gap",
    f"{_DISTANCES}.min_singleton_core_assignment_score",
    f"{_DISTANCES}.min_singleton_core_gap",
    f"{_DISTANCES}.min_partial_same_class_core_assignment_score",
    f"{_DISTANCES}.min_partial_same_class_core_gap",
    f"{_DISTANCES}.rank_sigma",
    f"{_DISTANCES}.rank_weight",
    f"{_DISTANCES}.discriminative_anchor_min_sep",
    f"{_DISTANCES}.anchor_pair_min_margin",
    f"{_DISTANCES}.debug_anchor_topk",
    f"{_DISTANCES}.debug_historical_anchor_topk",
    "update.max_misses",
    "update.temporary_tracks",
    "update.neighbor_graphs",
    "update.background_memory.promote_hits",
    "update.ambiguous_tracks.ttl_frames",
    "update.provisional_new.ttl_frames",
    "update.provisional_new.temporal_matching.parent_overlap_bonus",
    "testing",
    "debug",
)

# Lists of names that mean all of them when they are empty; an empty list means none elsewhere.
EMPTY_IS_ALL = (
    "association.ambiguous_tracks.allow_status",
    "association.provisional_new.allow_status",
)

_MANY_RELATIONS = 64
_MOST = 1000  # of what several keys decide together
_RADII = tuple(
    f"thresholds.perception.ring_{edge}" for edge in ("border", "inner", "outer", "limit")
)

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


def decided_settings(published: Any) -> dict[str, dict[str, Setting]]:
    """The settings that a key of the original decides alone, by that key and by their own."""
    decided: dict[str, dict[str, Setting]] = {}
    for path, _, record in walk_settings(published):
        for key in record.own_keys:
            decided.setdefault(key, {})[path] = record
    return decided


def translate(settings: Mapping[str, Any], published: Any) -> dict[str, Any]:
    """Nested settings of the original as ours. Raises ConfigError for unknown keys and values."""
    flat, decided = dict(flatten(settings)), decided_settings(published)
    values = {path: value for path, value, _ in walk_settings(published)}
    changes: dict[str, Any] = {}
    for key, value in flat.items():
        if key in decided:
            for path, record in decided[key].items():
                old = changes.get(path, values[path])
                if record.listed:
                    names = [gate.listed for gate in decided[key].values()]
                    changes[path] = record.listed in _listed(key, value, names)
                else:
                    changes[path] = _translated(key, value, record, old)
        elif key in FIXED:
            _allowed(key, value, (FIXED[key],))
        elif key in SHIPPED:
            _check_switch(key, value)
        elif not _is_inert(key):
            known = [*decided, *FIXED, *SHIPPED]
            raise ConfigError(
                f"the original has no configuration key {key!r}; {nearest_names(key, known)}"
            )
    changes.update(decide(flat))
    radii = [changes.get(radius, values[radius]) for radius in _RADII]
    changes["static.switches.ring_max_radius"] = max(1, *(r for r in radii if isinstance(r, int)))
    pending = "static.switches.pending_relations"
    defers = flat.get("update.robust_updates.enabled", False)
    every = flat.get("memory.neighbors.force_episode_every_frames", 3)
    if defers or not isinstance(every, int) or not 0 < every <= values[pending]:
        # Episodes may be far apart then, and relations wait for them without limit.
        changes[pending] = _MANY_RELATIONS
    return nest(changes)


def _translated(key: str, value: Any, record: Setting, old: Any) -> Any:
    """What a setting is by the original's value of a key."""
    if record.theirs is not None:
        return record.theirs[_allowed(key, value, record.theirs)]
    if isinstance(record.key, tuple):
        return tuple(
            value if place == key else kept for place, kept in zip(record.key, old, strict=True)
        )
    check_range(f"{key} of the original", value, record)
    if isinstance(old, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value


def _listed(key: str, value: Any, names: list[str]) -> set[str]:
    """The names that a list of the original holds."""
    listed = [] if value is None else value
    if not isinstance(listed, (list, tuple)):
        raise ConfigError(f"{key} of the original is {value!r}; it must be null or a list")
    given = {_allowed(key, str(name).upper(), names) for name in listed}
    return set(names) if not given and key in EMPTY_IS_ALL else given


def _check_switch(key: str, value: Any) -> None:
    shipped = SHIPPED[key]
    if key in CHOICES:
        _allowed(key, value, CHOICES[key])
    elif isinstance(shipped, bool):
        _allowed(key, value, (False, True))
    elif shipped is None:
        if value is not None and not isinstance(value, (list, tuple)):
            raise ConfigError(f"{key} of the original is {value!r}; it must be null or a list")
    elif isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= _MOST:
        raise ConfigError(
            f"{key} of the original is {value!r}; it must be a number from 0 to {_MOST}"
        )


def _is_inert(key: str) -> bool:
    return f"{key}.".startswith(tuple(f"{section}." for section in INERT))


def _allowed(key: str, value: Any, values: Any) -> Any:
    if value not in tuple(values):
        shown = ", ".join(str(v) for v in values)
        raise ConfigError(f"{key} of the original is {value!r}; supported here: {shown}")
    return value


def decide(given: Mapping[str, Any]) -> dict[str, Any]:
    """Turns these keys of the original into settings of this package."""
    get = {**SHIPPED, **given}.__getitem__
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
        "static.switches.ring_prototypes": get("bg_local.prototypes.enabled")
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
        "static.switches.context_hypotheses": listed,
        "static.switches.expected_neighbours": max(listed, math.ceil(listed * scale)),
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
        "static.switches.part_source": "both" if len(sources) == 2 else (sources or ["kmeans"])[0],
        "static.switches.part_resembling": resembling,
        "static.switches.attention_heads": tuple(get("part_descriptors.attention.head_ids") or ()),
        "thresholds.perception.parts_enabled": get("part_descriptors.enabled") and bool(sources),
        "thresholds.perception.kmeans_parts_kept": kept["kmeans"],
        "thresholds.perception.attention_parts_kept": kept["attention"],
    }


def _channels(get: Any, section: str, names: tuple[str, ...]) -> dict[str, bool]:
    """Which channels of a memory exist; one without any channel gets them all."""
    chosen = {name: get(f"{section}.channels.{name}.enabled") for name in names}
    none = not any(chosen.values())
    return {name: get(f"{section}.enabled") and (none or chosen[name]) for name in names}
