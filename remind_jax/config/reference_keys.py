"""The original's configuration keys and what they are called here; one table.

Every key of the original's default configuration stands in exactly one of the tables below.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from remind_jax.config import reference_switches
from remind_jax.config.dotted_keys import flatten, nest
from remind_jax.errors import ConfigError, nearest_names
from remind_jax.remind.thresholds import (
    attention_parts as attention_part_thresholds,
)
from remind_jax.remind.thresholds import (
    context as context_thresholds,
)
from remind_jax.remind.thresholds import (
    known_sets as known_set_thresholds,
)
from remind_jax.remind.thresholds import (
    outcome as outcome_thresholds,
)
from remind_jax.remind.thresholds import (
    relations as relation_thresholds,
)
from remind_jax.remind.thresholds import (
    ring_prototypes as ring_prototype_thresholds,
)

Path = str

_M = "association.matching"
_H = "association.matching.hungarian"
_Q = "association.similarity.quality"
_A = "update.appearance_memory"
_B = "update.background_memory"
_P = "update.parts_memory"

RENAMED: dict[Path, Path] = {
    **outcome_thresholds.RENAMED,
    **relation_thresholds.RENAMED,
    **context_thresholds.RENAMED,
    **known_set_thresholds.RENAMED,
    **ring_prototype_thresholds.RENAMED,
    **attention_part_thresholds.RENAMED,
    "system.input_width_size": "input.max_width_px",
    "perception.full_center_crop": "input.center_crop",
    "detector.ignored_classes": "input.ignored_classes",
    "bg_local.sanitize.keep_largest_component": "input.keep_largest",
    "bg_local.sanitize.fill_holes": "input.fill_holes",
    "bg_local.sanitize.close_px": "input.close_px",
    "bg_local.sanitize.open_px": "input.open_px",
    "object_features.global.weighted": "static.global_weighted",
    "object_features.global_trimmed.weighted": "static.trimmed_weighted",
    "object_features.patch.enabled": "thresholds.perception.count_patches",
    "object_features.global_trimmed.keep_frac": "thresholds.perception.trim_keep",
    "object_features.global_trimmed.min_patches": "thresholds.perception.trim_min_patches",
    "object_features.patch.max_patches": "thresholds.perception.max_counted_patches",
    "part_descriptors.kmeans.k": "static.part_clusters",
    "part_descriptors.kmeans.iters": "static.part_iterations",
    "part_descriptors.kmeans.n_init": "static.part_restarts",
    "part_descriptors.kmeans.seed": "static.part_seed",
    "part_descriptors.kmeans.min_cluster_patches": "thresholds.perception.part_min_patches",
    "part_descriptors.kmeans.min_support": "thresholds.perception.part_min_support",
    "part_descriptors.kmeans.weighted": "static.part_weighted",
    "part_descriptors.kmeans.trimmed_keep_frac": "thresholds.perception.part_trim_keep",
    "part_descriptors.kmeans.trimmed_min_patches": "thresholds.perception.part_trim_min_patches",
    "part_descriptors.kmeans.merge.sim_thr": "thresholds.perception.part_merge",
    "bg_local.enabled": "thresholds.perception.rings_enabled",
    "bg_local.inner_radius_patches": "thresholds.perception.ring_inner",
    "bg_local.outer_radius_patches": "thresholds.perception.ring_outer",
    "bg_local.obj_patch_min_coverage": "thresholds.perception.ring_object_coverage",
    "bg_local.adaptive.enabled": "thresholds.perception.ring_adaptive",
    "bg_local.adaptive.min_inner_patches": "thresholds.perception.ring_min_inner",
    "bg_local.adaptive.min_outer_patches": "thresholds.perception.ring_min_outer",
    "bg_local.adaptive.max_radius_patches": "thresholds.perception.ring_limit",
    "bg_local.adaptive.border_exclusion_patches": "thresholds.perception.ring_border",
    "memory.start_object_id": "static.first_object_id",
    "memory.background.combine_weights.inner": "thresholds.similarity.inner_share",
    "memory.background.combine_weights.outer": "thresholds.similarity.outer_share",
    "association.similarity.parts.topk": "static.part_top",
    f"{_Q}.enabled": "thresholds.similarity.quality_enabled",
    f"{_Q}.object.min_patches": "thresholds.similarity.object_min_patches",
    f"{_Q}.object.full_patches": "thresholds.similarity.object_full_patches",
    f"{_Q}.object.min_coverage_density": "thresholds.similarity.object_min_density",
    f"{_Q}.object.full_coverage_density": "thresholds.similarity.object_full_density",
    f"{_Q}.object.weight_floor": "thresholds.similarity.object_floor",
    f"{_Q}.parts.disable_below_obj_patches": "thresholds.similarity.parts_disabled_below",
    f"{_Q}.parts.min_obj_patches": "thresholds.similarity.parts_min_patches",
    f"{_Q}.parts.full_obj_patches": "thresholds.similarity.parts_full_patches",
    f"{_Q}.parts.min_parts": "thresholds.similarity.parts_min_count",
    f"{_Q}.parts.full_parts": "thresholds.similarity.parts_full_count",
    f"{_Q}.parts.min_support_frac": "thresholds.similarity.parts_min_support",
    f"{_Q}.parts.full_support_frac": "thresholds.similarity.parts_full_support",
    f"{_Q}.parts.min_coverage_density": "thresholds.similarity.parts_min_density",
    f"{_Q}.parts.full_coverage_density": "thresholds.similarity.parts_full_density",
    f"{_Q}.parts.weight_floor": "thresholds.similarity.parts_floor",
    f"{_Q}.background.min_inner_patches": "thresholds.similarity.background_min_inner",
    f"{_Q}.background.full_inner_patches": "thresholds.similarity.background_full_inner",
    f"{_Q}.background.min_outer_patches": "thresholds.similarity.background_min_outer",
    f"{_Q}.background.full_outer_patches": "thresholds.similarity.background_full_outer",
    f"{_Q}.background.min_mask_quality": "thresholds.similarity.background_min_mask_quality",
    f"{_Q}.background.weight_floor": "thresholds.similarity.background_floor",
    "association.confirmation.confirm_thr_strong": "thresholds.diagnosis.anchor_score",
    "association.confirmation.confirm_clear_margin": "thresholds.diagnosis.anchor_margin",
    f"{_M}.match_thr": "thresholds.matching.match",
    f"{_M}.renormalize_missing": "thresholds.similarity.renormalize",
    f"{_M}.weights.object": "thresholds.similarity.object_weight",
    f"{_M}.weights.background_global": "thresholds.similarity.background_weight",
    f"{_M}.weights.parts": "thresholds.similarity.parts_weight",
    f"{_H}.enable_dummies": "thresholds.matching.dummies",
    f"{_H}.dummy_score": "thresholds.matching.dummy_score",
    f"{_H}.use_confidence_dummy": "thresholds.matching.dummy_by_confidence",
    f"{_H}.conf_alpha": "thresholds.matching.dummy_confidence_gain",
    f"{_H}.dummy_score_cap": "thresholds.matching.dummy_cap",
    f"{_H}.gate_by_match_thr": "thresholds.matching.gate_match",
    f"{_H}.gate_by_min_match_score": "thresholds.matching.gate_min_visual",
    f"{_H}.locks.enabled": "thresholds.matching.locks",
    f"{_H}.locks.object_enabled": "thresholds.matching.object_locks",
    f"{_H}.locks.det_enabled": "thresholds.matching.detection_locks",
    f"{_H}.locks.thr": "thresholds.matching.lock_score",
    f"{_H}.locks.gap_abs_min": "thresholds.matching.lock_gap",
    f"{_H}.locks.gap_rel_thr": "thresholds.matching.lock_relative_gap",
    "association.ambiguity.enabled": "thresholds.diagnosis.enabled",
    "association.ambiguity.close_delta": "thresholds.diagnosis.close",
    "association.ambiguity.strong_gap": "thresholds.diagnosis.strong_gap",
    "association.ambiguity.strong_min_score": "thresholds.diagnosis.strong_score",
    "association.ambiguity.ambiguous_min_score": "thresholds.diagnosis.ambiguous_score",
    "association.confidence.enabled": "thresholds.diagnosis.confidence_enabled",
    "association.confidence.eps": "thresholds.diagnosis.small",
    "association.confidence.temperature": "thresholds.diagnosis.temperature",
    "association.confidence.min_temperature": "thresholds.diagnosis.temperature_least",
    "association.confidence.min_gap_k": "thresholds.diagnosis.gap_scale_least",
    "association.confidence.coverage_target": "thresholds.diagnosis.coverage_target",
    "association.confidence.gap_center": "thresholds.diagnosis.gap_center",
    "association.confidence.gap_k": "thresholds.diagnosis.gap_scale",
    "update.min_match_score": "thresholds.matching.min_visual",
    "update.confirm_hits": "thresholds.lifecycle.confirm_hits",
    "update.remove_enabled": "static.remove_objects",
    "update.max_misses_tentative": "thresholds.lifecycle.max_misses_tentative",
    "update.max_misses_confirmed": "thresholds.lifecycle.max_misses_confirmed",
    "update.inactive_ttl": "thresholds.lifecycle.max_misses_inactive",
    "update.robust_updates.enabled": "thresholds.update.gated",
    "update.robust_updates.safe_alpha_scale": "thresholds.update.ambiguous_rate",
    f"{_A}.dup_thr": "thresholds.appearance.duplicate",
    f"{_A}.novel_thr": "thresholds.appearance.novel",
    f"{_A}.merge_thr": "thresholds.appearance.merge",
    f"{_A}.count_cap": "thresholds.appearance.merge_cap",
    f"{_A}.promote_hits": "thresholds.appearance.promote_hits",
    f"{_A}.stable_dup_thr": "thresholds.appearance.stable_duplicate",
    f"{_A}.stable_merge_thr": "thresholds.appearance.stable_merge",
    f"{_A}.quality_min_patches": "thresholds.appearance.patches_min",
    f"{_A}.quality_full_patches": "thresholds.appearance.patches_full",
    f"{_A}.create_min_quality": "thresholds.appearance.create_quality",
    f"{_A}.promote_min_quality": "thresholds.appearance.promote_quality",
    f"{_A}.work_update_min_quality": "thresholds.appearance.work_quality",
    f"{_A}.stable_update_min_quality": "thresholds.appearance.stable_quality",
    f"{_A}.update_nn_on_skip": "thresholds.appearance.refresh_work",
    f"{_A}.dup_update.ema_on_dup": "thresholds.appearance.gated_update",
    f"{_A}.dup_update.margin": "thresholds.appearance.update_margin",
    f"{_A}.dup_update.alpha_min": "thresholds.appearance.update_rate_min",
    f"{_A}.dup_update.alpha_max": "thresholds.appearance.update_rate_max",
    f"{_B}.work_dup_thr": "thresholds.background.duplicate",
    f"{_B}.work_merge_thr": "thresholds.background.merge",
    f"{_B}.promote_hits_global": "thresholds.background.promote_hits",
    f"{_B}.stable_dup_thr": "thresholds.background.stable_duplicate",
    f"{_B}.count_cap": "thresholds.background.merge_cap",
    f"{_B}.global_create_min_quality": "thresholds.background.create_quality",
    f"{_B}.global_promote_min_quality": "thresholds.background.promote_quality",
    f"{_B}.global_work_update_min_quality": "thresholds.background.work_quality",
    f"{_B}.global_stable_update_min_quality": "thresholds.background.stable_quality",
    f"{_B}.global_inner_min_patches": "thresholds.background.inner_min_patches",
    f"{_B}.global_inner_full_patches": "thresholds.background.inner_full_patches",
    f"{_B}.global_outer_min_patches": "thresholds.background.outer_min_patches",
    f"{_B}.global_outer_full_patches": "thresholds.background.outer_full_patches",
    f"{_B}.global_min_mask_quality": "thresholds.background.min_mask_quality",
    f"{_B}.dup_update.margin": "thresholds.background.update_margin",
    f"{_B}.dup_update.alpha_min": "thresholds.background.update_rate_min",
    f"{_B}.dup_update.alpha_max": "thresholds.background.update_rate_max",
    f"{_B}.stable_dup_update.margin": "thresholds.background.stable_margin",
    f"{_B}.stable_dup_update.alpha_min": "thresholds.background.stable_rate_min",
    f"{_B}.stable_dup_update.alpha_max": "thresholds.background.stable_rate_max",
    f"{_P}.dup_thr": "thresholds.parts.duplicate",
    f"{_P}.novel_thr": "thresholds.parts.novel",
    f"{_P}.merge_thr": "thresholds.parts.merge",
    f"{_P}.greedy_1to1": "thresholds.parts.one_to_one",
    f"{_P}.promote_hits": "thresholds.parts.promote_hits",
    f"{_P}.stable_dup_thr": "thresholds.parts.stable_duplicate",
    f"{_P}.stable_merge_thr": "thresholds.parts.stable_merge",
    f"{_P}.dup_update.margin": "thresholds.parts.update_margin",
    f"{_P}.dup_update.alpha_min": "thresholds.parts.update_rate_min",
    f"{_P}.dup_update.alpha_max": "thresholds.parts.update_rate_max",
    f"{_P}.merge.count_cap": "thresholds.parts.merge_cap",
}

_EVICT = {"redundant": "redundant", "lru": "oldest"}
_INSERT = {"always": "always", "novel_only": "novel"}
_WEIGHT = {"equal": "equal", "count_capped": "capped"}

# Keys whose values have other names here.
CHOICES: dict[Path, tuple[Path, dict[Any, Any]]] = {
    **outcome_thresholds.CHOICES,
    **relation_thresholds.CHOICES,
    **ring_prototype_thresholds.CHOICES,
    **attention_part_thresholds.CHOICES,
    "bg_local.ring_mode": (
        "thresholds.perception.ring_nested",
        {"disjoint": False, "nested": True},
    ),
    "part_descriptors.kmeans.use_trimmed_mean": (
        "static.part_mean",
        {False: "plain", True: "trimmed"},
    ),
    f"{_M}.proto_source_mode": ("static.banks_read", {"default": "both", "work_only": "work"}),
    f"{_M}.object_mode": (
        "static.object_channel",
        {"max": "best", "global": "global", "global_trimmed": "trimmed"},
    ),
    f"{_M}.parts_mode": (
        "static.part_channel",
        {"max": "best", "kmeans": "kmeans", "attention": "attention"},
    ),
    f"{_M}.background_mode": (
        "static.ring_channel",
        {"combined": "combined", "inner": "inner", "outer": "outer"},
    ),
    "association.confidence.margin_mode": (
        "static.margin",
        {
            "sigmoid_abs": "sigmoid",
            "linear_abs": "linear",
            "linear_rel": "linear_relative",
            "sigmoid_rel": "sigmoid_relative",
        },
    ),
    f"{_A}.insert_policy": ("static.appearance_insert", _INSERT),
    f"{_A}.evict_strategy": ("static.appearance_evict", _EVICT),
    f"{_A}.stable_evict_strategy": ("static.appearance_stable_evict", _EVICT),
    f"{_A}.merge_weight": ("static.appearance_merge", _WEIGHT),
    f"{_B}.work_evict_strategy": ("static.ring_evict", _EVICT),
    f"{_B}.stable_update": (
        "thresholds.background.stable_update",
        {"count_capped": True, "none": False, "off": False, "skip": False},
    ),
    f"{_P}.insert_policy": ("static.part_insert", _INSERT),
    f"{_P}.evict_strategy": ("static.part_evict", _EVICT),
    f"{_P}.merge.merge_weight": ("static.part_merge", _WEIGHT),
}

# Places in pairs: capacities of the work and the stable bank, bounds.
SLOTS: dict[Path, tuple[tuple[Path, int], ...]] = {
    **ring_prototype_thresholds.SLOTS,
    "memory.appearance.max_prototypes_per_channel": (("static.appearance_slots", 0),),
    "memory.appearance.max_stable_prototypes_per_channel": (("static.appearance_slots", 1),),
    "memory.parts.max_prototypes_per_channel": (("static.part_slots", 0), ("static.part_slots", 1)),
    "memory.background.max_inner": (("static.inner_ring_slots", 0),),
    "memory.background.max_outer": (("static.outer_ring_slots", 0),),
    "memory.background.max_inner_global_stable": (("static.inner_ring_slots", 1),),
    "memory.background.max_outer_global_stable": (("static.outer_ring_slots", 1),),
}

# Lists of names: the gate of every name that may be listed.
SUBSETS: dict[Path, dict[str, Path]] = {**outcome_thresholds.SUBSETS, **context_thresholds.SUBSETS}

# Keys that are supported with this value only.
FIXED: dict[Path, Any] = {
    **context_thresholds.FIXED,
    # Without these every observation is kept for ever, and memory has no bound.
    f"{_A}.enabled": True,
    f"{_P}.enabled": True,
}

# Keys, or whole sections, that never change an identity in a supported setting.
INERT: tuple[Path, ...] = (
    *outcome_thresholds.INERT,
    *relation_thresholds.INERT,
    *context_thresholds.INERT,
    *known_set_thresholds.INERT,
    *attention_part_thresholds.INERT,
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
    "part_descriptors.kmeans.return_masks",
    "bg_local.combine_weights",
    "update.max_misses",
    "update.temporary_tracks",
    "update.neighbor_graphs",
    f"{_B}.promote_hits",
    "testing",
    "debug",
)

_MANY_RELATIONS = 64
_RADII = tuple(
    f"thresholds.perception.ring_{edge}" for edge in ("border", "inner", "outer", "limit")
)


def translate(settings: Mapping[str, Any], published: Mapping[str, Any]) -> dict[str, Any]:
    """Turns nested settings of the original into nested settings of this package.

    Raises:
      ConfigError: For a key that the original does not have, or a value that is not supported.
    """
    flat = dict(flatten(settings))
    defaults = dict(flatten(published))
    changes: dict[Path, Any] = {}
    for key, value in flat.items():
        if key in RENAMED:
            _check_limit(key, value)
            changes[RENAMED[key]] = _like(value, defaults[RENAMED[key]])
        elif key in CHOICES:
            name, values = CHOICES[key]
            changes[name] = values[_allowed(key, value, values)]
        elif key in SLOTS:
            for name, position in SLOTS[key]:
                pair = list(changes.get(name, defaults[name]))
                pair[position] = value
                changes[name] = tuple(pair)
        elif key in SUBSETS:
            changes.update(_gates(key, value))
        elif key in FIXED:
            _allowed(key, value, (FIXED[key],))
        elif key in reference_switches.SHIPPED:
            _check_switch(key, value)
        elif not _within(key, INERT):
            known = [*RENAMED, *CHOICES, *SLOTS, *SUBSETS, *FIXED, *reference_switches.SHIPPED]
            raise ConfigError(
                f"the original has no configuration key {key!r}; {nearest_names(key, known)}"
            )
    changes.update(reference_switches.decide(flat))
    radii = [changes.get(radius, defaults[radius]) for radius in _RADII]
    changes["static.ring_max_radius"] = max(1, *(r for r in radii if isinstance(r, int)))
    defers = flat.get("update.robust_updates.enabled", False)
    every = flat.get("memory.neighbors.force_episode_every_frames", 3)
    if defers or not 0 < every <= defaults["static.pending_relations"]:
        # Episodes may be far apart then, and relations wait for them without limit.
        changes["static.pending_relations"] = _MANY_RELATIONS
    return nest(changes)


def _check_limit(key: Path, value: Any) -> None:
    most, why = outcome_thresholds.LIMITS.get(key, (math.inf, ""))
    if isinstance(value, (int, float)) and value > most:
        raise ConfigError(
            f"{key} of the original is {value!r}; supported here: up to {most}, {why}"
        )


def _gates(key: Path, value: Any) -> dict[Path, bool]:
    """The gate of every name, open for those that are listed."""
    gates, listed = SUBSETS[key], [] if value is None else value
    if not isinstance(listed, (list, tuple)):
        raise ConfigError(f"{key} of the original is {value!r}; it must be null or a list")
    names = {_allowed(key, str(name).upper(), gates) for name in listed}
    if not names and key in outcome_thresholds.EMPTY_IS_ALL:
        names = set(gates)
    return {path: name in names for name, path in gates.items()}


def _check_switch(key: Path, value: Any) -> None:
    shipped = reference_switches.SHIPPED[key]
    if key in reference_switches.CHOICES:
        _allowed(key, value, reference_switches.CHOICES[key])
    elif isinstance(shipped, bool):
        _allowed(key, value, (False, True))
    elif shipped is None:
        if value is not None and not isinstance(value, (list, tuple)):
            raise ConfigError(f"{key} of the original is {value!r}; it must be null or a list")
    elif isinstance(value, bool) or not isinstance(value, (int, float)) or value < 0:
        raise ConfigError(f"{key} of the original is {value!r}; it must be a number from 0 on")


def _within(key: Path, sections: tuple[Path, ...]) -> bool:
    return any(key == section or key.startswith(section + ".") for section in sections)


def _allowed(key: Path, value: Any, values: Any) -> Any:
    if value not in tuple(values):
        shown = ", ".join(str(v) for v in values)
        raise ConfigError(f"{key} of the original is {value!r}; supported here: {shown}")
    return value


def _like(value: Any, default: Any) -> Any:
    """Whole numbers where this package counts in whole numbers, numbers elsewhere."""
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value
