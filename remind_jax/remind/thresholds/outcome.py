"""Thresholds of what may stay undecided: look-alikes, competition, ambiguous, provisional."""

from __future__ import annotations

import dataclasses

import jax

from remind_jax.numerics.kinds import Gate, Real, Whole


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Stability:
    """When an assignment among look-alikes is too close to call (method.md#identity-stability)."""

    enabled: Gate = True  # look for assignments that are too close to call
    assignment_gap: Real = 0.05  # two best joint assignments closer than this are ambiguous
    alternative_margin: Real = 0.05  # lead of a rival that makes a rescued pair fragile
    keep_margin: Real = 0.03  # lead that lets a rescued pair stand after all
    max_members: Whole = 4  # larger groups are not compared; four at most
    rescued_fragile: Gate = True  # pairs that context rescued can be fragile
    passed_fragile: Gate = False  # pairs above the match threshold can be fragile


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Competition:
    """When a new detection and a match claim one object (method.md#competition)."""

    enabled: Gate = True  # new detections may take a match into doubt
    young_only: Gate = True  # unconfirmed parents must be young
    max_parent_age: Whole = 2  # frames since the birth of a young parent
    confirmed_parents: Gate = True  # confirmed objects may be parents as well
    single_create: Gate = True  # at most one new detection per parent
    min_score: Real = 0.75  # least score of both detections with the parent
    max_gap: Real = 0.05  # largest difference of the two scores
    confirmed_min_score: Real = 0.85  # as min_score, for confirmed parents
    confirmed_max_gap: Real = 0.03  # as max_gap, for confirmed parents


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Ambiguous:
    """When a detection could be one of several known objects.

    Rules: method.md#plausible-score, method.md#ambiguity.
    """

    enabled: Gate = True  # detections may stay undecided between known objects
    max_candidates: Whole = 3  # most candidates that are named, three at most
    supported_only: Gate = True  # only candidates that context supports, or visual near-ties
    max_supported: Whole = 3  # with more supported candidates nothing is said
    known_set_score: Gate = True  # compare candidates on the evidence that all have
    min_top: Real = 0.45  # least score of the best candidate
    min_candidate: Real = 0.40  # least score of every candidate
    gap: Real = 0.05  # candidates this close to the best are plausible,
    relative_gap: Real = 0.10  # or this close as a share of the best
    gap_slack: Real = 1e-4  # tolerance of both
    min_relative_support: Real = 0.65  # support relative to the class that counts as support
    min_net_support: Real = 0.20  # support less contradiction that counts as support
    clear_margin: Real = 0.08  # unsupported match and supported rival closer than this
    require_context: Gate = True  # only if context supports a candidate, or by the fallback
    override_match: Gate = True  # a match may become ambiguous
    override_strong: Gate = False  # a match with one candidate near the best may
    override_ambiguous: Gate = True  # a match with several candidates near the best may
    override_weak: Gate = True  # a match without a good candidate may
    visual_fallback: Gate = True  # near-ties of the visual score count without context
    visual_only_without_context: Gate = True  # fallback only where context supports nobody
    visual_min_top: Real = 0.75  # fallback: least visual score of the best candidate
    visual_gap: Real = 0.03  # fallback: candidates this close to the best are near-ties
    visual_slack: Real = 1e-4  # fallback: tolerance of that
    visual_max: Whole = 3  # fallback: most near-ties that are named, three at most


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Provisional:
    """When an unmatched detection may still be a known object.

    Rules: method.md#plausible-score, method.md#provisional.
    """

    enabled: Gate = True  # unmatched detections may stay provisional
    min_top: Real = 0.60  # least score of the best supported object
    min_candidate: Real = 0.50  # least score of every object named as support
    gap: Real = 0.10  # objects this close to the best are support,
    relative_gap: Real = 0.12  # or this close as a share of the best
    gap_slack: Real = 1e-4  # tolerance of both
    max_support: Whole = 3  # known objects named as support, three at most
    from_strong: Gate = False  # a detection with one object near the best may be provisional
    from_ambiguous: Gate = True  # a detection with several objects near the best may
    from_weak: Gate = True  # a detection without a good object may
    require_context: Gate = True  # only if context supports an object, or by the fallback
    visual_fallback: Gate = True  # a near miss of the match threshold counts without context
    visual_only_without_context: Gate = True  # fallback only where context supports nobody
    visual_single_only: Gate = False  # only for detections with a single candidate
    visual_margin: Real = 0.02  # how far below the match threshold a near miss may be
    visual_min_score: Real = 0.70  # least visual score of a near miss
    visual_min_gap: Real = 0.08  # least lead of a near miss
    visual_max_close: Whole = 1  # most candidates close to the best


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Pending:
    """How undecided detections of successive frames are joined to tracks.

    Rule: method.md#pending-tracks.
    """

    ambiguous_enabled: Gate = True  # remember ambiguous detections
    ambiguous_matching: Gate = True  # and join them over time
    ambiguous_min_overlap: Real = 0.5  # least overlap of the candidates (Dice)
    ambiguous_min_visual: Real = 0.55  # least visual similarity to an ambiguous track
    ambiguous_min_total: Real = 0.62  # least score of a join with the terms below
    ambiguous_overlap_weight: Real = 0.18  # weight of the overlap of candidates in it
    ambiguous_scores_weight: Real = 0.10  # weight of the agreement of their scores
    ambiguous_place_weight: Real = 0.08  # weight of the place in the frame
    provisional_enabled: Gate = True  # remember provisional detections
    provisional_matching: Gate = True  # and join them over time
    provisional_min_visual: Real = 0.60  # least visual similarity to a provisional track
    provisional_min_total: Real = 0.62  # least score of a join with the terms below
    provisional_overlap_weight: Real = 0.08  # weight of the overlap of supporting objects in it
    provisional_scores_weight: Real = 0.08  # weight of the agreement of their scores
    provisional_place_weight: Real = 0.06  # weight of the place in the frame
    provisional_without_parent: Gate = True  # join tracks that name no known object
    origin_min_overlap: Real = 0.5  # least overlap of support that lets an object grow out of it


_H = "association.matching.hungarian"
_A = "association.ambiguous_tracks"
_P = "association.provisional_new"
_U = "update.ambiguous_tracks"
_V = "update.provisional_new"

RENAMED: dict[str, str] = {
    "association.matching.clear_margin": "thresholds.ambiguous.clear_margin",
    f"{_H}.identity_stability.enabled": "thresholds.stability.enabled",
    f"{_H}.identity_stability.assignment_gap_max": "thresholds.stability.assignment_gap",
    f"{_H}.identity_stability.alt_margin": "thresholds.stability.alternative_margin",
    f"{_H}.identity_stability.keep_margin": "thresholds.stability.keep_margin",
    f"{_H}.identity_stability.component_max_size": "thresholds.stability.max_members",
    f"{_H}.committed_new_competition.enabled": "thresholds.competition.enabled",
    f"{_H}.committed_new_competition.require_young_parent": "thresholds.competition.young_only",
    f"{_H}.committed_new_competition.parent_max_age": "thresholds.competition.max_parent_age",
    f"{_H}.committed_new_competition.allow_confirmed_parent": (
        "thresholds.competition.confirmed_parents"
    ),
    f"{_H}.committed_new_competition.require_single_create_per_parent": (
        "thresholds.competition.single_create"
    ),
    f"{_H}.committed_new_competition.min_score": "thresholds.competition.min_score",
    f"{_H}.committed_new_competition.pair_gap_max": "thresholds.competition.max_gap",
    f"{_H}.committed_new_competition.confirmed_min_score": (
        "thresholds.competition.confirmed_min_score"
    ),
    f"{_H}.committed_new_competition.confirmed_pair_gap_max": (
        "thresholds.competition.confirmed_max_gap"
    ),
    f"{_A}.enabled": "thresholds.ambiguous.enabled",
    f"{_A}.max_candidates": "thresholds.ambiguous.max_candidates",
    f"{_A}.supported_only": "thresholds.ambiguous.supported_only",
    f"{_A}.max_supported_candidates": "thresholds.ambiguous.max_supported",
    f"{_A}.min_top_score": "thresholds.ambiguous.min_top",
    f"{_A}.min_candidate_score": "thresholds.ambiguous.min_candidate",
    f"{_A}.gap_max": "thresholds.ambiguous.gap",
    f"{_A}.gap_rel_max": "thresholds.ambiguous.relative_gap",
    f"{_A}.gap_eps": "thresholds.ambiguous.gap_slack",
    f"{_A}.min_compat_rel": "thresholds.ambiguous.min_relative_support",
    f"{_A}.min_sets_score": "thresholds.ambiguous.min_net_support",
    f"{_A}.require_context": "thresholds.ambiguous.require_context",
    f"{_A}.allow_override_match": "thresholds.ambiguous.override_match",
    f"{_A}.visual_fallback.enabled": "thresholds.ambiguous.visual_fallback",
    f"{_A}.visual_fallback.require_context_missing": (
        "thresholds.ambiguous.visual_only_without_context"
    ),
    f"{_A}.visual_fallback.min_top_score": "thresholds.ambiguous.visual_min_top",
    f"{_A}.visual_fallback.gap_max": "thresholds.ambiguous.visual_gap",
    f"{_A}.visual_fallback.gap_eps": "thresholds.ambiguous.visual_slack",
    f"{_A}.visual_fallback.max_candidates": "thresholds.ambiguous.visual_max",
    f"{_P}.enabled": "thresholds.provisional.enabled",
    f"{_P}.min_top_score": "thresholds.provisional.min_top",
    f"{_P}.min_candidate_score": "thresholds.provisional.min_candidate",
    f"{_P}.support_gap_max": "thresholds.provisional.gap",
    f"{_P}.support_gap_rel_max": "thresholds.provisional.relative_gap",
    f"{_P}.support_gap_eps": "thresholds.provisional.gap_slack",
    f"{_P}.support_topk": "thresholds.provisional.max_support",
    f"{_P}.require_context": "thresholds.provisional.require_context",
    f"{_P}.visual_fallback.enabled": "thresholds.provisional.visual_fallback",
    f"{_P}.visual_fallback.require_context_missing": (
        "thresholds.provisional.visual_only_without_context"
    ),
    f"{_P}.visual_fallback.single_candidate_only": "thresholds.provisional.visual_single_only",
    f"{_P}.visual_fallback.eps": "thresholds.provisional.visual_margin",
    f"{_P}.visual_fallback.min_score": "thresholds.provisional.visual_min_score",
    f"{_P}.visual_fallback.min_gap": "thresholds.provisional.visual_min_gap",
    f"{_P}.visual_fallback.max_close": "thresholds.provisional.visual_max_close",
    f"{_U}.enabled": "thresholds.pending.ambiguous_enabled",
    f"{_U}.min_candidate_overlap": "thresholds.pending.ambiguous_min_overlap",
    f"{_U}.temporal_matching.enabled": "thresholds.pending.ambiguous_matching",
    f"{_U}.temporal_matching.min_score_sim": "thresholds.pending.ambiguous_min_visual",
    f"{_U}.temporal_matching.min_total_score": "thresholds.pending.ambiguous_min_total",
    f"{_U}.temporal_matching.candidate_overlap_weight": (
        "thresholds.pending.ambiguous_overlap_weight"
    ),
    f"{_U}.temporal_matching.candidate_distribution_weight": (
        "thresholds.pending.ambiguous_scores_weight"
    ),
    f"{_U}.temporal_matching.geom_weight": "thresholds.pending.ambiguous_place_weight",
    f"{_V}.enabled": "thresholds.pending.provisional_enabled",
    f"{_V}.min_support_overlap": "thresholds.pending.origin_min_overlap",
    f"{_V}.temporal_matching.enabled": "thresholds.pending.provisional_matching",
    f"{_V}.temporal_matching.min_score_sim": "thresholds.pending.provisional_min_visual",
    f"{_V}.temporal_matching.min_total_score": "thresholds.pending.provisional_min_total",
    f"{_V}.temporal_matching.parent_overlap_weight": (
        "thresholds.pending.provisional_overlap_weight"
    ),
    f"{_V}.temporal_matching.parent_distribution_weight": (
        "thresholds.pending.provisional_scores_weight"
    ),
    f"{_V}.temporal_matching.geom_weight": "thresholds.pending.provisional_place_weight",
    f"{_V}.temporal_matching.allow_empty_parent_match": (
        "thresholds.pending.provisional_without_parent"
    ),
}

CHOICES = {
    f"{_A}.score_mode": (
        "thresholds.ambiguous.known_set_score",
        {"known_set": True, "final": False},
    )
}

# Lists of names: a gate for each name.
SUBSETS = {
    f"{_H}.identity_stability.fragile_gate_reasons": {
        "SETS_RESCUE": "thresholds.stability.rescued_fragile",
        "PASS_MATCH_THR": "thresholds.stability.passed_fragile",
    },
    f"{_A}.allow_status": {
        "STRONG": "thresholds.ambiguous.override_strong",
        "AMBIGUOUS": "thresholds.ambiguous.override_ambiguous",
        "WEAK": "thresholds.ambiguous.override_weak",
    },
    f"{_P}.allow_status": {
        "STRONG": "thresholds.provisional.from_strong",
        "AMBIGUOUS": "thresholds.provisional.from_ambiguous",
        "WEAK": "thresholds.provisional.from_weak",
    },
}

# An empty list means all of them here, none of them elsewhere.
EMPTY_IS_ALL = (f"{_A}.allow_status", f"{_P}.allow_status")

_NAMES_THREE = (3, "an undecided detection names three objects at most")

# Largest value of a number, and what stands in the way of more.
LIMITS = {
    f"{_H}.identity_stability.component_max_size": (
        4,
        "complete assignments of larger groups are not enumerated",
    ),
    f"{_A}.max_candidates": _NAMES_THREE,
    f"{_A}.visual_fallback.max_candidates": _NAMES_THREE,
    f"{_P}.support_topk": _NAMES_THREE,
}

INERT = (
    f"{_U}.ttl_frames",
    f"{_V}.ttl_frames",
    f"{_V}.temporal_matching.parent_overlap_bonus",
)
