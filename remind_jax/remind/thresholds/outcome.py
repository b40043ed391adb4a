"""Thresholds of what may stay undecided: look-alikes, competition, ambiguous, provisional."""

from __future__ import annotations

from remind_jax.numerics.pytree import pytree
from remind_jax.settings.kinds import Gate, Real, Whole
from remind_jax.settings.record import setting

# Where the original keeps these settings.
_S = "association.matching.hungarian.identity_stability"
_C = "association.matching.hungarian.committed_new_competition"
_A = "association.ambiguous_tracks"
_P = "association.provisional_new"
_U = "update.ambiguous_tracks"
_V = "update.provisional_new"

# fmt: off


@pytree
class Stability:
    """When an assignment among look-alikes is too close to call (method.md#identity-stability)."""

    enabled: Gate = setting(True, "look for assignments that are too close to call",
        key=f"{_S}.enabled")
    assignment_gap: Real = setting(0.05,
        "two best joint assignments closer than this are ambiguous", "score",
        more="more look-alikes stay undecided", key=f"{_S}.assignment_gap_max")
    alternative_margin: Real = setting(0.05, "lead of a rival that makes a rescued pair fragile",
        "score", more="fewer rescued pairs are doubted", key=f"{_S}.alt_margin")
    keep_margin: Real = setting(0.03, "lead that lets a rescued pair stand after all", "score",
        more="fewer doubted pairs stand", key=f"{_S}.keep_margin")
    max_members: Whole = setting(4, "larger groups are not compared", "detections",
        more="more look-alikes stay undecided", key=f"{_S}.component_max_size", most=4,
        why="complete assignments of larger groups are not enumerated")
    rescued_fragile: Gate = setting(True, "pairs that context rescued can be fragile",
        key=f"{_S}.fragile_gate_reasons", listed="SETS_RESCUE")
    passed_fragile: Gate = setting(False, "pairs above the match threshold can be fragile",
        key=f"{_S}.fragile_gate_reasons", listed="PASS_MATCH_THR")


@pytree
class Competition:
    """When a new detection and a match claim one object (method.md#competition)."""

    enabled: Gate = setting(True, "new detections may take a match into doubt", key=f"{_C}.enabled")
    young_only: Gate = setting(True, "unconfirmed parents must be young",
        key=f"{_C}.require_young_parent")
    max_parent_age: Whole = setting(2, "frames since the birth of a young parent", "frames",
        more="more competitions", key=f"{_C}.parent_max_age")
    confirmed_parents: Gate = setting(True, "confirmed objects may be parents as well",
        key=f"{_C}.allow_confirmed_parent")
    single_create: Gate = setting(True, "at most one new detection per parent",
        key=f"{_C}.require_single_create_per_parent")
    min_score: Real = setting(0.75, "least score of both detections with the parent", "score",
        more="fewer competitions", key=f"{_C}.min_score")
    max_gap: Real = setting(0.05, "largest difference of the two scores", "score",
        more="more competitions", key=f"{_C}.pair_gap_max")
    confirmed_min_score: Real = setting(0.85, "as min_score, for confirmed parents", "score",
        more="fewer competitions with confirmed objects", key=f"{_C}.confirmed_min_score")
    confirmed_max_gap: Real = setting(0.03, "as max_gap, for confirmed parents", "score",
        more="more competitions with confirmed objects", key=f"{_C}.confirmed_pair_gap_max")


@pytree
class Ambiguous:
    """When a detection could be one of several known objects.

    Rules: method.md#plausible-score, method.md#ambiguity.
    """

    enabled: Gate = setting(True, "detections may stay undecided between known objects",
        key=f"{_A}.enabled")
    max_candidates: Whole = setting(3, "most candidates that are named", "objects",
        more="larger candidate sets are allowed", key=f"{_A}.max_candidates", most=3,
        why="an undecided detection names three objects at most")
    supported_only: Gate = setting(True,
        "only candidates that context supports, or visual near-ties", key=f"{_A}.supported_only")
    max_supported: Whole = setting(3, "with more supported candidates nothing is said", "objects",
        more="more stays undecided", key=f"{_A}.max_supported_candidates")
    known_set_score: Gate = setting(True, "compare candidates on the evidence that all have",
        key=f"{_A}.score_mode", theirs={"known_set": True, "final": False})
    min_top: Real = setting(0.45, "least score of the best candidate", "score",
        more="less stays undecided", key=f"{_A}.min_top_score")
    min_candidate: Real = setting(0.40, "least score of every candidate", "score",
        more="smaller candidate sets, less stays undecided", key=f"{_A}.min_candidate_score")
    gap: Real = setting(0.05, "candidates this close to the best are plausible,", "score",
        more="larger candidate sets, more stays undecided", key=f"{_A}.gap_max")
    relative_gap: Real = setting(0.10, "or this close as a share of the best", "share of the score",
        more="larger candidate sets, more stays undecided", key=f"{_A}.gap_rel_max")
    gap_slack: Real = setting(1e-4, "tolerance of both", "score", more="as gap, in the last digits",
        key=f"{_A}.gap_eps")
    min_relative_support: Real = setting(0.65,
        "support relative to the class that counts as support", "share",
        more="fewer candidates are supported", key=f"{_A}.min_compat_rel")
    min_net_support: Real = setting(0.20, "support less contradiction that counts as support",
        "support", more="fewer candidates are supported", key=f"{_A}.min_sets_score")
    clear_margin: Real = setting(0.08, "unsupported match and supported rival closer than this",
        "score", more="more matches are taken back", key="association.matching.clear_margin")
    require_context: Gate = setting(True,
        "only if context supports a candidate, or by the fallback", key=f"{_A}.require_context")
    override_match: Gate = setting(True, "a match may become ambiguous",
        key=f"{_A}.allow_override_match")
    override_strong: Gate = setting(False, "a match with one candidate near the best may",
        key=f"{_A}.allow_status", listed="STRONG")
    override_ambiguous: Gate = setting(True, "a match with several candidates near the best may",
        key=f"{_A}.allow_status", listed="AMBIGUOUS")
    override_weak: Gate = setting(True, "a match without a good candidate may",
        key=f"{_A}.allow_status", listed="WEAK")
    visual_fallback: Gate = setting(True, "near-ties of the visual score count without context",
        key=f"{_A}.visual_fallback.enabled")
    visual_only_without_context: Gate = setting(True, "fallback only where context supports nobody",
        key=f"{_A}.visual_fallback.require_context_missing")
    visual_min_top: Real = setting(0.75, "fallback: least visual score of the best candidate",
        "score", more="less stays undecided by looks alone",
        key=f"{_A}.visual_fallback.min_top_score")
    visual_gap: Real = setting(0.03, "fallback: candidates this close to the best are near-ties",
        "score", more="more stays undecided by looks alone", key=f"{_A}.visual_fallback.gap_max")
    visual_slack: Real = setting(1e-4, "fallback: tolerance of that", "score",
        more="as visual_gap, in the last digits", key=f"{_A}.visual_fallback.gap_eps")
    visual_max: Whole = setting(3, "fallback: most near-ties that are named", "objects",
        more="larger candidate sets by looks alone", key=f"{_A}.visual_fallback.max_candidates",
        most=3, why="an undecided detection names three objects at most")


@pytree
class Provisional:
    """When an unmatched detection may still be a known object.

    Rules: method.md#plausible-score, method.md#provisional.
    """

    enabled: Gate = setting(True, "unmatched detections may stay provisional", key=f"{_P}.enabled")
    min_top: Real = setting(0.60, "least score of the best supported object", "score",
        more="less stays provisional, more is new", key=f"{_P}.min_top_score")
    min_candidate: Real = setting(0.50, "least score of every object named as support", "score",
        more="fewer known objects are named", key=f"{_P}.min_candidate_score")
    gap: Real = setting(0.10, "objects this close to the best are support,", "score",
        more="more known objects are named", key=f"{_P}.support_gap_max")
    relative_gap: Real = setting(0.12, "or this close as a share of the best", "share of the score",
        more="more known objects are named", key=f"{_P}.support_gap_rel_max")
    gap_slack: Real = setting(1e-4, "tolerance of both", "score", more="as gap, in the last digits",
        key=f"{_P}.support_gap_eps")
    max_support: Whole = setting(3, "known objects named as support", "objects",
        more="more known objects are named", key=f"{_P}.support_topk", most=3,
        why="an undecided detection names three objects at most")
    from_strong: Gate = setting(False,
        "a detection with one object near the best may be provisional", key=f"{_P}.allow_status",
        listed="STRONG")
    from_ambiguous: Gate = setting(True, "a detection with several objects near the best may",
        key=f"{_P}.allow_status", listed="AMBIGUOUS")
    from_weak: Gate = setting(True, "a detection without a good object may",
        key=f"{_P}.allow_status", listed="WEAK")
    require_context: Gate = setting(True, "only if context supports an object, or by the fallback",
        key=f"{_P}.require_context")
    visual_fallback: Gate = setting(True,
        "a near miss of the match threshold counts without context",
        key=f"{_P}.visual_fallback.enabled")
    visual_only_without_context: Gate = setting(True, "fallback only where context supports nobody",
        key=f"{_P}.visual_fallback.require_context_missing")
    visual_single_only: Gate = setting(False, "only for detections with a single candidate",
        key=f"{_P}.visual_fallback.single_candidate_only")
    visual_margin: Real = setting(0.02, "how far below the match threshold a near miss may be",
        "score", more="more near misses stay provisional", key=f"{_P}.visual_fallback.eps")
    visual_min_score: Real = setting(0.70, "least visual score of a near miss", "score",
        more="fewer near misses stay provisional", key=f"{_P}.visual_fallback.min_score")
    visual_min_gap: Real = setting(0.08, "least lead of a near miss", "score",
        more="fewer near misses stay provisional", key=f"{_P}.visual_fallback.min_gap")
    visual_max_close: Whole = setting(1, "most candidates close to the best", "objects",
        more="more near misses stay provisional", key=f"{_P}.visual_fallback.max_close")


@pytree
class Pending:
    """How undecided detections are joined to tracks (method.md#pending-tracks)."""

    ambiguous_enabled: Gate = setting(True, "remember ambiguous detections", key=f"{_U}.enabled")
    ambiguous_matching: Gate = setting(True, "and join them over time",
        key=f"{_U}.temporal_matching.enabled")
    ambiguous_min_overlap: Real = setting(0.5, "least overlap of the candidates (Dice)", "share",
        more="more and shorter tracks", key=f"{_U}.min_candidate_overlap")
    ambiguous_min_visual: Real = setting(0.55, "least visual similarity to an ambiguous track",
        "score", more="more and shorter tracks", key=f"{_U}.temporal_matching.min_score_sim")
    ambiguous_min_total: Real = setting(0.62, "least score of a join with the terms below", "score",
        more="more and shorter tracks", key=f"{_U}.temporal_matching.min_total_score")
    ambiguous_overlap_weight: Real = setting(0.18, "weight of the overlap of candidates in it",
        "score", more="common candidates join more",
        key=f"{_U}.temporal_matching.candidate_overlap_weight")
    ambiguous_scores_weight: Real = setting(0.10, "weight of the agreement of their scores",
        "score", more="equal scores join more",
        key=f"{_U}.temporal_matching.candidate_distribution_weight")
    ambiguous_place_weight: Real = setting(0.08, "weight of the place in the frame", "score",
        more="nearness in the frame joins more", key=f"{_U}.temporal_matching.geom_weight")
    provisional_enabled: Gate = setting(True, "remember provisional detections",
        key=f"{_V}.enabled")
    provisional_matching: Gate = setting(True, "and join them over time",
        key=f"{_V}.temporal_matching.enabled")
    provisional_min_visual: Real = setting(0.60, "least visual similarity to a provisional track",
        "score", more="more and shorter tracks", key=f"{_V}.temporal_matching.min_score_sim")
    provisional_min_total: Real = setting(0.62, "least score of a join with the terms below",
        "score", more="more and shorter tracks", key=f"{_V}.temporal_matching.min_total_score")
    provisional_overlap_weight: Real = setting(0.08,
        "weight of the overlap of supporting objects in it", "score",
        more="common support joins more", key=f"{_V}.temporal_matching.parent_overlap_weight")
    provisional_scores_weight: Real = setting(0.08, "weight of the agreement of their scores",
        "score", more="equal scores join more",
        key=f"{_V}.temporal_matching.parent_distribution_weight")
    provisional_place_weight: Real = setting(0.06, "weight of the place in the frame", "score",
        more="nearness in the frame joins more", key=f"{_V}.temporal_matching.geom_weight")
    provisional_without_parent: Gate = setting(True, "join tracks that name no known object",
        key=f"{_V}.temporal_matching.allow_empty_parent_match")
    origin_min_overlap: Real = setting(0.5,
        "least overlap of support that lets an object grow out of it", "share",
        more="fewer tracks end in a new object", key=f"{_V}.min_support_overlap")
