"""Thresholds of the association: similarity, how clear it is, and who is matched."""

from __future__ import annotations

from remind_jax.numerics.pytree import pytree
from remind_jax.settings.kinds import Gate, Real
from remind_jax.settings.record import setting

# Where the original keeps these settings.
_Q = "association.similarity.quality"
_W = "association.matching.weights"
_H = "association.matching.hungarian"
_C = "association.confidence"
_D = "association.ambiguity"

# fmt: off


@pytree
class Similarity:
    """One visual score from the channels (method.md#channel-scores, method.md#visual-score)."""

    object_weight: Real = setting(0.60, "weight of the appearance", "weight",
        more="the appearance decides more", symbol="w_obj", key=f"{_W}.object")
    background_weight: Real = setting(0.25, "weight of the background rings", "weight",
        more="the background decides more", symbol="w_bg", key=f"{_W}.background_global")
    parts_weight: Real = setting(0.10, "weight of the parts", "weight",
        more="the parts decide more", symbol="w_parts", key=f"{_W}.parts")
    ring_prototypes_weight: Real = setting(0.05, "weight of typical patches of the rings", "weight",
        more="they decide more (static.ring_prototypes)", key=f"{_W}.background_partials")
    renormalize: Gate = setting(True, "divide by the weights of the channels that are present",
        key="association.matching.renormalize_missing")
    nominal_if_silent: Gate = setting(False,
        "where quality leaves no channel any weight, they keep their own")
    inner_share: Real = setting(0.60, "weight of the inner ring in the background score", "weight",
        more="the close background decides more", key="memory.background.combine_weights.inner")
    outer_share: Real = setting(0.40, "weight of the outer ring in it", "weight",
        more="the wide background decides more", key="memory.background.combine_weights.outer")

    quality_enabled: Gate = setting(True, "weigh channels by the quality of the observation",
        key=f"{_Q}.enabled")
    object_floor: Real = setting(0.65, "share of the object weight that quality cannot take away",
        "share", more="the appearance counts in poor views as well",
        key=f"{_Q}.object.weight_floor")
    background_floor: Real = setting(0.35, "the same for the background weight", "share",
        more="the background counts in poor views as well", key=f"{_Q}.background.weight_floor")
    parts_floor: Real = setting(0.0, "the same for the parts weight", "share",
        more="parts count in poor views as well", key=f"{_Q}.parts.weight_floor")
    object_min_patches: Real = setting(8.0, "effective patches at quality 0", "effective patches",
        more="the look of small views counts less", key=f"{_Q}.object.min_patches")
    object_full_patches: Real = setting(32.0, "effective patches at quality 1", "effective patches",
        more="fewer views count in full", key=f"{_Q}.object.full_patches",
        not_below="object_min_patches")
    object_min_density: Real = setting(0.15, "mean coverage of the patches at weight 0", "coverage",
        more="the look of thin masks counts less", key=f"{_Q}.object.min_coverage_density")
    object_full_density: Real = setting(0.60, "mean coverage of the patches at full weight",
        "coverage", more="fewer views count in full", key=f"{_Q}.object.full_coverage_density",
        not_below="object_min_density")
    parts_disabled_below: Real = setting(8.0, "effective patches below which parts do not count",
        "effective patches", more="fewer views are compared by parts",
        key=f"{_Q}.parts.disable_below_obj_patches")
    parts_min_patches: Real = setting(12.0, "effective patches at which parts have quality 0",
        "effective patches", more="parts of small views count less",
        key=f"{_Q}.parts.min_obj_patches")
    parts_full_patches: Real = setting(32.0, "effective patches at which parts have quality 1",
        "effective patches", more="parts count in full in fewer views",
        key=f"{_Q}.parts.full_obj_patches",
        not_below="parts_min_patches")
    parts_min_count: Real = setting(2.0, "number of parts at quality 0", "parts",
        more="few parts count less", key=f"{_Q}.parts.min_parts")
    parts_full_count: Real = setting(4.0, "number of parts at quality 1", "parts",
        more="parts count in full in fewer views", key=f"{_Q}.parts.full_parts",
        not_below="parts_min_count")
    parts_min_support: Real = setting(0.15,
        "share of the object that its parts cover, at quality 0", "share of the object",
        more="small parts count less", key=f"{_Q}.parts.min_support_frac")
    parts_full_support: Real = setting(0.45, "the same at quality 1", "share of the object",
        more="parts count in full in fewer views", key=f"{_Q}.parts.full_support_frac",
        not_below="parts_min_support")
    parts_min_density: Real = setting(0.15,
        "mean coverage of the patches at which parts have weight 0", "coverage",
        more="parts of thin masks count less", key=f"{_Q}.parts.min_coverage_density")
    parts_full_density: Real = setting(0.60, "the same at full weight", "coverage",
        more="parts count in full in fewer views", key=f"{_Q}.parts.full_coverage_density",
        not_below="parts_min_density")
    background_min_inner: Real = setting(8.0, "patches of the inner ring at quality 0", "patches",
        more="small inner rings count less", key=f"{_Q}.background.min_inner_patches")
    background_full_inner: Real = setting(20.0, "patches of the inner ring at quality 1", "patches",
        more="rings count in full in fewer views", key=f"{_Q}.background.full_inner_patches",
        not_below="background_min_inner")
    background_min_outer: Real = setting(12.0, "patches of the outer ring at quality 0", "patches",
        more="small outer rings count less", key=f"{_Q}.background.min_outer_patches")
    background_full_outer: Real = setting(32.0, "patches of the outer ring at quality 1", "patches",
        more="rings count in full in fewer views", key=f"{_Q}.background.full_outer_patches",
        not_below="background_min_outer")
    background_min_mask_quality: Real = setting(0.50, "solidity of the mask at quality 0",
        "solidity", more="rings of ragged masks count less",
        key=f"{_Q}.background.min_mask_quality")


@pytree
class Diagnosis:
    """How clear the evidence of one detection is (method.md#reliable-anchors, method.md#status)."""

    anchor_score: Real = setting(0.75, "least best score of a reliable anchor", "score",
        more="fewer anchors, thus less context", key="association.confirmation.confirm_thr_strong")
    anchor_margin: Real = setting(0.08, "least lead of a reliable anchor", "score",
        more="fewer anchors, thus less context", symbol="δ_confirm",
        key="association.confirmation.confirm_clear_margin")
    enabled: Gate = setting(True, "tell STRONG, AMBIGUOUS and WEAK detections apart",
        key=f"{_D}.enabled")
    close: Real = setting(0.03, "candidates within this distance of the best are close", "score",
        more="more candidates are close; fewer detections STRONG", key=f"{_D}.close_delta")
    strong_score: Real = setting(0.80, "least best score of STRONG", "score",
        more="fewer detections STRONG", key=f"{_D}.strong_min_score")
    strong_gap: Real = setting(0.08, "least lead of STRONG", "score",
        more="fewer detections STRONG", key=f"{_D}.strong_gap")
    ambiguous_score: Real = setting(0.75, "least best score of AMBIGUOUS, WEAK below", "score",
        more="more detections WEAK", key=f"{_D}.ambiguous_min_score")
    confidence_enabled: Gate = setting(True, "rate how sure a decision is; off: confidence 0",
        key=f"{_C}.enabled")
    small: Real = setting(1e-6, "what the confidence does not divide by less than", "score",
        more="none but to keep out zero", key=f"{_C}.eps")
    temperature: Real = setting(0.05, "lead that counts clearly in the confidence, as a softness",
        "score", more="less confidence for the same lead", key=f"{_C}.temperature")
    temperature_least: Real = setting(0.05, "replaces a temperature that is too small", "score",
        more="as temperature, where that is too small", key=f"{_C}.min_temperature")
    coverage_target: Real = setting(0.60, "share of the four channels that is enough",
        "share of the channels", more="less confidence where channels are missing",
        key=f"{_C}.coverage_target")
    gap_center: Real = setting(0.10, 'lead that counts half, with static.margin "sigmoid"', "score",
        more="less confidence for the same lead", key=f"{_C}.gap_center")
    gap_scale: Real = setting(0.05, "softness of that step", "score",
        more="the lead matters more gradually", key=f"{_C}.gap_k")
    gap_scale_least: Real = setting(0.05, "replaces a scale that is too small", "score",
        more="as gap_scale, where that is too small", key=f"{_C}.min_gap_k")


@pytree
class Matching:
    """Gates, locks and the joint assignment (method.md#gating, method.md#joint-assignment)."""

    match: Real = setting(0.75, "least final score of a match", "score",
        more="fewer matches, more that is new or undecided", symbol="τ_match",
        key="association.matching.match_thr")
    min_visual: Real = setting(0.60, "least visual score of a match", "score",
        more="fewer matches by context, more that is new or undecided",
        key="update.min_match_score")
    gate_match: Gate = setting(True, "pairs below `match` do not enter the assignment",
        key=f"{_H}.gate_by_match_thr")
    gate_min_visual: Gate = setting(True, "pairs below `min_visual` do not enter the assignment",
        key=f"{_H}.gate_by_min_match_score")
    locks: Gate = setting(True, "clear wins are settled before the assignment",
        key=f"{_H}.locks.enabled")
    object_locks: Gate = setting(True, "an object's clear best detection may lock",
        key=f"{_H}.locks.object_enabled")
    detection_locks: Gate = setting(True, "a detection's clear best object may lock",
        key=f"{_H}.locks.det_enabled")
    lock_score: Real = setting(0.90, "least score of a lock", "score",
        more="fewer locks, more is left to the joint assignment", symbol="τ_lock",
        key=f"{_H}.locks.thr")
    lock_gap: Real = setting(0.10, "least lead of a lock", "score",
        more="fewer locks, more is left to the joint assignment", key=f"{_H}.locks.gap_abs_min")
    lock_relative_gap: Real = setting(0.10, "least lead as a share of the score",
        "share of the score", more="fewer locks", key=f"{_H}.locks.gap_rel_thr")
    dummies: Gate = setting(True, "a detection may stay unassigned at a cost",
        key=f"{_H}.enable_dummies")
    dummy_score: Real = setting(0.05, "score of staying unassigned", "score",
        more="detections give way more easily", key=f"{_H}.dummy_score")
    dummy_by_confidence: Gate = setting(True, "uncertain detections give way more easily",
        key=f"{_H}.use_confidence_dummy")
    dummy_confidence_gain: Real = setting(0.20, "what full uncertainty adds to dummy_score",
        "score", more="uncertain detections give way more easily", key=f"{_H}.conf_alpha")
    dummy_cap: Real = setting(0.72, "largest score of staying unassigned", "score",
        more="uncertain detections give way more easily", key=f"{_H}.dummy_score_cap")
    one_detection_each: Gate = setting(False, "an object goes to one detection of a frame at most")
