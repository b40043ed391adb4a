"""Thresholds of the disambiguation: groups of look-alikes told apart by distances."""

from __future__ import annotations

from remind_jax.numerics.pytree import pytree
from remind_jax.settings.kinds import Gate, Real, Whole
from remind_jax.settings.record import setting

# Where the original keeps these settings.
_K = "association.ambiguous_tracks.known_set_distance_disambiguation"

# fmt: off


@pytree
class KnownSets:
    """When closed groups of look-alikes are told apart by distances (method.md#known-sets).

    Distances are in units of object size: pixels divided by the mean size of the two objects.
    """

    enabled: Gate = setting(True, "tell look-alikes apart by distances at all", key=f"{_K}.enabled")
    # which undecided detections form one group
    link_distance: Real = setting(1.75,
        "detections farther apart are linked by shared candidates only", "object sizes",
        more="larger groups", key=f"{_K}.max_component_pair_distance")
    link_score: Real = setting(0.08,
        "least agreement with remembered distances that links detections", "agreement",
        more="smaller groups", key=f"{_K}.min_component_pair_score")
    gap_sigma: Real = setting(0.20, "decay of the agreement of two gaps", "object sizes",
        more="a wrong gap counts less", key=f"{_K}.gap_sigma")
    centre_sigma: Real = setting(0.35, "the same for center distances, where no gap is known",
        "object sizes", more="a wrong distance counts less", key=f"{_K}.center_sigma")
    gap_quality_weight: Real = setting(0.35, "how much an unreliable gap counts against a relation",
        "share", more="unreliable gaps count less", key=f"{_K}.obs_gap_quality_weight")
    truncation_penalty: Real = setting(0.50, "loss of a relation at the frame's border", "share",
        more="what the border cuts counts less", key=f"{_K}.obs_truncation_penalty")
    support_penalty: Real = setting(0.80,
        "loss of a relation between an object and what it stands on", "share",
        more="what stands on each other counts less", key=f"{_K}.support_penalty")
    min_reliability: Real = setting(0.15, "least reliability of a remembered distance, [0, 1]",
        "reliability", more="fewer remembered distances are used", key=f"{_K}.min_edge_reliability")
    # which surrounding objects vote
    soft_anchors: Gate = setting(True, "objects that are likely but not decided may vote as well",
        key=f"{_K}.soft_anchors_enabled")
    soft_min_score: Real = setting(0.75, "least score of such an object", "score",
        more="fewer undecided objects vote", key=f"{_K}.soft_anchor_min_score")
    soft_confidence: Real = setting(0.35, "how much its score counts in its usefulness", "share",
        more="doubtful voters count less", key=f"{_K}.soft_anchor_conf_weight")
    max_anchors: Whole = setting(4,
        "most anchors; static.group_anchors and max_pairs limit them as well", "objects",
        more="more voters", key=f"{_K}.max_anchors")
    max_pairs: Whole = setting(3, "an anchor is rated by so many of the pairs that it orders best",
        "pairs", more="an anchor must order more pairs well", key=f"{_K}.anchor_pair_topk")
    min_usefulness: Real = setting(0.10, "least usefulness of an anchor", "usefulness",
        more="fewer voters, more stays undecided", key=f"{_K}.min_anchor_informativeness")
    usefulness_share: Real = setting(0.60, "least usefulness as a share of the best anchor's",
        "share", more="fewer voters beside the best", key=f"{_K}.selected_anchor_score_ratio_min")
    history_weight: Real = setting(0.60, "how well the anchor used to tell the candidates apart",
        "weight", more="anchors that told them apart before are preferred",
        key=f"{_K}.anchor_history_score_weight")
    frame_weight: Real = setting(0.40, "how differently far the detections are from it now",
        "weight", more="anchors that tell them apart now are preferred",
        key=f"{_K}.anchor_frame_score_weight")
    span_ref: Real = setting(0.20, "difference of two distances that is large", "object sizes",
        more="differences must be larger to count", key=f"{_K}.anchor_span_ref")
    strength_scale: Real = setting(1.10, "stretches the references of the strength of a difference",
        "factor", more="differences must be larger to count", key=f"{_K}.distance_score_scale")
    strength_power: Real = setting(2.8, "how sharply that strength rises", "exponent",
        more="small differences count less", key=f"{_K}.distance_score_power")
    # how an anchor votes
    margin_ref: Real = setting(0.20, "difference between two margins that is large", "object sizes",
        more="margins may differ more", key=f"{_K}.order_margin_ref")
    order_weight: Real = setting(0.65, "how often the order was seen, against the mean distances",
        "weight", more="the usual order counts more than the mean distance",
        key=f"{_K}.anchor_pair_order_weight")
    margin_weight: Real = setting(0.35, "agreement of the margin, against the order", "weight",
        more="the margin counts more than the order", key=f"{_K}.anchor_pair_margin_weight")
    min_consistency: Real = setting(0.60,
        "least share of the usual order that recommends an anchor", "share",
        more="fewer voters, more stays undecided", key=f"{_K}.anchor_pair_min_consistency")
    consistency_floor: Real = setting(0.45, "weight of an order that was never consistent",
        "weight", more="inconsistent orders count more", key=f"{_K}.consistency_floor")
    consistency_power: Real = setting(0.75, "how sharply that weight rises", "exponent",
        more="inconsistent orders count less", key=f"{_K}.consistency_power")
    # when an assignment is accepted
    anchor_weight: Real = setting(0.55, "share of the anchors in the score", "weight",
        more="distances decide more", key=f"{_K}.anchor_weight")
    visual_weight: Real = setting(0.10, "share of the appearance in the score", "weight",
        more="looks decide more", key=f"{_K}.visual_weight")
    min_evidence: Real = setting(0.20, "least summed weight of the anchors", "weight",
        more="more stays undecided", key=f"{_K}.min_total_evidence")
    min_score: Real = setting(0.20, "least score of the best assignment", "score",
        more="more stays undecided", key=f"{_K}.min_assignment_score")
    min_core: Real = setting(0.18, "least score of the best assignment without appearance", "score",
        more="more stays undecided", key=f"{_K}.min_full_sibling_core_assignment_score")
    min_core_gap: Real = setting(0.06, "least lead of that score", "score",
        more="more stays undecided", key=f"{_K}.min_full_sibling_core_gap")
    full_gap: Real = setting(0.08,
        "lead from which a solution is called full, partial below; label only", "score",
        more="fewer solutions are called full; decisions are the same", key=f"{_K}.min_gap")
