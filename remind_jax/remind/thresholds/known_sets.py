"""Numbers of the known-set disambiguation and the original's keys for them.

Rule: method.md#known-sets.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax

from remind_jax.numerics.kinds import Gate, Real, Whole


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class KnownSets:
    """When closed groups of look-alikes are told apart by distances (method.md#known-sets).

    Distances are in units of object size: pixels divided by the mean size of the two objects.
    """

    enabled: Gate = True  # tell look-alikes apart by distances at all
    # which undecided detections form one group
    link_distance: Real = 1.75  # detections farther apart are linked by shared candidates only
    link_score: Real = 0.08  # least agreement with remembered distances that links detections
    gap_sigma: Real = 0.20  # decay of the agreement of two gaps
    centre_sigma: Real = 0.35  # the same for centre distances, where no gap is known
    gap_quality_weight: Real = 0.35  # how much an unreliable gap counts against a relation
    truncation_penalty: Real = 0.50  # loss of a relation at the frame's border
    support_penalty: Real = 0.80  # loss of a relation between an object and what it stands on
    min_reliability: Real = 0.15  # least reliability of a remembered distance, [0, 1]
    # which surrounding objects vote
    soft_anchors: Gate = True  # objects that are likely but not decided may vote as well
    soft_min_score: Real = 0.75  # least score of such an object
    soft_confidence: Real = 0.35  # how much its score counts in its usefulness
    max_anchors: Whole = 4  # most anchors; static.group_anchors and max_pairs limit them as well
    max_pairs: Whole = 3  # an anchor is rated by so many of the pairs that it orders best
    min_usefulness: Real = 0.10  # least usefulness of an anchor
    usefulness_share: Real = 0.60  # least usefulness as a share of the best anchor's
    history_weight: Real = 0.60  # how well the anchor used to tell the candidates apart
    frame_weight: Real = 0.40  # how differently far the detections are from it now
    span_ref: Real = 0.20  # difference of two distances that is large
    strength_scale: Real = 1.10  # stretches the references of the strength of a difference
    strength_power: Real = 2.8  # how sharply that strength rises
    # how an anchor votes
    margin_ref: Real = 0.20  # difference between two margins that is large
    order_weight: Real = 0.65  # how often the order was seen, against the mean distances
    margin_weight: Real = 0.35  # agreement of the margin, against the order
    min_consistency: Real = 0.60  # least share of the usual order that recommends an anchor
    consistency_floor: Real = 0.45  # weight of an order that was never consistent
    consistency_power: Real = 0.75  # how sharply that weight rises
    # when an assignment is accepted
    anchor_weight: Real = 0.55  # share of the anchors in the score
    visual_weight: Real = 0.10  # share of the appearance in the score
    min_evidence: Real = 0.20  # least summed weight of the anchors
    min_score: Real = 0.20  # least score of the best assignment
    min_core: Real = 0.18  # least score of the best assignment without appearance
    min_core_gap: Real = 0.06  # least lead of that score
    full_gap: Real = 0.08  # lead from which a solution is called full, partial below; label only


_K = "association.ambiguous_tracks.known_set_distance_disambiguation"

RENAMED: dict[str, str] = {
    f"{_K}.{key}": path
    for key, path in {
        "enabled": "thresholds.known_sets.enabled",
        "max_passes": "static.max_passes",
        "max_group_size": "static.group_size",
        "max_candidate_union": "static.group_candidates",
        "discriminative_anchor_topk": "static.group_anchors",
        "soft_anchor_max": "static.soft_anchors",
        "max_anchors": "thresholds.known_sets.max_anchors",
        "anchor_pair_topk": "thresholds.known_sets.max_pairs",
        "selected_anchor_score_ratio_min": "thresholds.known_sets.usefulness_share",
        "anchor_weight": "thresholds.known_sets.anchor_weight",
        "visual_weight": "thresholds.known_sets.visual_weight",
        "anchor_history_score_weight": "thresholds.known_sets.history_weight",
        "anchor_frame_score_weight": "thresholds.known_sets.frame_weight",
        "min_edge_reliability": "thresholds.known_sets.min_reliability",
        "min_anchor_informativeness": "thresholds.known_sets.min_usefulness",
        "min_total_evidence": "thresholds.known_sets.min_evidence",
        "min_assignment_score": "thresholds.known_sets.min_score",
        "min_full_sibling_core_assignment_score": "thresholds.known_sets.min_core",
        "min_full_sibling_core_gap": "thresholds.known_sets.min_core_gap",
        "min_gap": "thresholds.known_sets.full_gap",
        "gap_sigma": "thresholds.known_sets.gap_sigma",
        "center_sigma": "thresholds.known_sets.centre_sigma",
        "obs_gap_quality_weight": "thresholds.known_sets.gap_quality_weight",
        "obs_truncation_penalty": "thresholds.known_sets.truncation_penalty",
        "support_penalty": "thresholds.known_sets.support_penalty",
        "max_component_pair_distance": "thresholds.known_sets.link_distance",
        "min_component_pair_score": "thresholds.known_sets.link_score",
        "anchor_span_ref": "thresholds.known_sets.span_ref",
        "order_margin_ref": "thresholds.known_sets.margin_ref",
        "distance_score_power": "thresholds.known_sets.strength_power",
        "distance_score_scale": "thresholds.known_sets.strength_scale",
        "consistency_floor": "thresholds.known_sets.consistency_floor",
        "consistency_power": "thresholds.known_sets.consistency_power",
        "anchor_pair_order_weight": "thresholds.known_sets.order_weight",
        "anchor_pair_margin_weight": "thresholds.known_sets.margin_weight",
        "anchor_pair_min_consistency": "thresholds.known_sets.min_consistency",
        "soft_anchors_enabled": "thresholds.known_sets.soft_anchors",
        "soft_anchor_min_score": "thresholds.known_sets.soft_min_score",
        "soft_anchor_conf_weight": "thresholds.known_sets.soft_confidence",
    }.items()
}

# Keys that are supported with this value only: none.
FIXED: dict[str, Any] = {}

# Keys of modes that are never reached, of unused terms, and of debug output.
INERT: tuple[str, ...] = tuple(
    f"{_K}.{key}"
    for key in (
        "min_core_assignment_score",
        "min_core_gap",
        "min_singleton_core_assignment_score",
        "min_singleton_core_gap",
        "min_partial_same_class_core_assignment_score",
        "min_partial_same_class_core_gap",
        "rank_sigma",
        "rank_weight",
        "discriminative_anchor_min_sep",
        "anchor_pair_min_margin",
        "debug_anchor_topk",
        "debug_historical_anchor_topk",
    )
)
