"""Numbers of the context: which objects go together here, and what follows for a candidate."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax

from remind_jax.numerics.kinds import Gate, Real, Whole


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Sets:
    """How sets of objects that may be in view are built and scored (method.md#hypotheses)."""

    min_set_score: Real = 0.0  # hypotheses below are dropped
    min_link: Real = 0.05  # conditional probability from which an object speaks for another
    drop_weak_links: Gate = True  # links below min_link add nothing to the density
    partial: Gate = True  # a set may leave a class in view unexplained
    max_classes: Whole = 0  # classes that sets are built from, those of few objects first; 0: all
    prior_sets: Whole = 0  # best sets that tell how likely an object is in view; 0: all
    maturity_rate: Real = 0.25  # maturity is 1 - exp(-rate * episodes)
    density_power: Real = 1.0  # of the share of linked pairs in the density
    min_links: Whole = 1  # links that every member needs
    linked_power: Real = 1.5  # of the share of members with a link; felt only if min_links is 0
    pairs_power: Real = 1.0  # of the share of linked pairs in the connection
    coverage_power: Real = 1.0  # of the share of detections that a set explains
    coverage_gain: Real = 0.35  # extra coverage in frames of many detections
    coverage_gain_scale: Real = 3.0  # detections over which that gain builds up
    explained_scale: Real = 1.5  # explained detections over which coverage builds up; 0: at once
    exclusivity: Gate = True  # rate how far the best choice of a class leads
    exclusivity_min_size: Whole = 3  # smallest set that is rated so
    exclusivity_min_maturity: Real = 0.35  # least mean maturity of a set that is rated so
    exclusivity_eps: Real = 1e-12  # support up to here is none
    size_free: Whole = 2  # members that earn nothing for size
    size_scale: Real = 2.0  # further members over which the size term builds up
    choice_penalty: Real = 0.35  # loss per nat of choices within a class
    stability_eps: Real = 1e-12  # support up to here is none
    plausible_share: Real = 0.75  # of the best support, from which an object is plausible
    fill_power: Real = 1.0  # of the share of plausible objects that a choice takes
    info_reference: Real = 2.0  # set size at which the information term has its full weight
    info_power: Real = 0.5  # decline of that weight beyond it
    info_weight_min: Real = 0.35  # least weight of the information term
    info_weight_max: Real = 1.0  # largest weight of the information term
    exclusivity_reference: Real = 3.0  # the same of the exclusivity term
    exclusivity_power: Real = 0.5  # decline of its weight beyond that size
    exclusivity_weight_min: Real = 0.35  # least weight of the exclusivity term
    exclusivity_weight_max: Real = 1.0  # largest weight of the exclusivity term
    maturity: Gate = True  # trust sets of mature objects more
    maturity_mean: Real = -3.0  # exponent of the power mean over the members; 0: geometric
    maturity_power: Real = 0.85  # of that mean in the score of a set
    coverage_weight: Real = 0.40  # share of the coverage in the score of a set
    size_weight: Real = 0.20  # share of the size term
    density_weight: Real = 0.20  # share of the density
    info_weight: Real = 0.10  # share of the information term
    support_weight: Real = 0.10  # share of the support within classes
    stability_weight: Real = 0.10  # share of the stability within classes
    exclusivity_weight: Real = 0.05  # share of the exclusivity term
    shortlist_loss: Real = 0.10  # loss against the best score up to which members are short-listed


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Influence:
    """What the context adds to or takes from a candidate.

    Rules: method.md#class-summary, method.md#cooccurrence-bonus.
    """

    enabled: Gate = True  # context at all; off also stops rescue and vetoes
    on_strong: Gate = False  # change scores of detections whose evidence is strong
    on_ambiguous: Gate = True  # change scores of detections whose evidence is ambiguous
    on_weak: Gate = True  # change scores of detections whose evidence is weak
    positive_cap: Real = 0.20  # largest bonus [delta_plus]
    negative_cap: Real = 0.10  # largest penalty [delta_minus]
    min_quality: Real = 0.35  # least quality of a context that counts
    rescue_visual: Real = 0.60  # least visual score of a pair that a bonus may rescue [tau_vis,min]
    min_best_score: Real = 0.45  # least score of the best set of a context that counts
    min_coverage: Real = 0.35  # least coverage of that set
    min_size: Whole = 2  # least size of that set
    size_scale: Real = 3.0  # members over which the size term of the quality builds up
    best_weight: Real = 0.25  # share of the best set's score in the quality of a context
    coverage_weight: Real = 0.20  # share of its coverage
    maturity_weight: Real = 0.15  # share of its maturity
    density_weight: Real = 0.10  # share of its density
    size_weight: Real = 0.15  # share of its size
    pruning_weight: Real = 0.15  # share of how many candidates it rules out
    local_weight: Real = 0.65  # share of the support by the surroundings
    global_weight: Real = 0.35  # share of the support by the rank within the class
    local_hits_weight: Real = 0.60  # share of the hits in the local support
    local_count_weight: Real = 0.20  # share of their number in it
    local_kernel_weight: Real = 0.20  # share of their strength in it
    strength_kernel_weight: Real = 0.75  # share of the kernel in the strength of a class
    strength_prior_weight: Real = 0.25  # share of the hypotheses in it
    top_weight: Real = 0.65  # share of the best hypothesis in the relative rank by hypotheses
    sum_weight: Real = 0.35  # share of all hypotheses in it
    kernel_power: Real = 0.75  # compresses relative support by the kernel
    hypothesis_power: Real = 0.75  # compresses relative support by hypotheses
    neutral: Real = 0.20  # relative support that earns nothing
    min_kernel: Real = 0.10  # least absolute support by the kernel
    min_hits: Whole = 2  # least members of the kernel that speak for the object
    min_hit_share: Real = 0.25  # least share of the kernel that does
    local_min_kernel: Real = 0.10  # as min_kernel, for local support
    local_min_hits: Whole = 2  # as min_hits, for local support
    local_min_hit_share: Real = 0.25  # as min_hit_share, for local support
    band: Real = 0.80  # of the best relative support, from which an object is supported
    soft_band: Real = 0.65  # of the best mixed support, from which it is softly supported
    soft_kernel_weight: Real = 0.70  # share of the kernel in the mixed support
    soft_hypothesis_weight: Real = 0.30  # share of the hypotheses in it
    pruned_weight: Real = 0.55  # share of the pruning in the global support
    rank_weight: Real = 0.30  # share of the rank in it
    selectivity_weight: Real = 0.15  # share of the selectivity in it
    contradiction_min_pruning: Real = 0.35  # least pruning of a class that can contradict
    contradiction_min_strength: Real = 0.35  # least strength of such a class
    contradiction_max_support: Real = 0.10  # largest relative support that is contradicted


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Veto:
    """When the context rules a pair out (method.md#veto)."""

    enabled: Gate = True  # pairs may be ruled out
    max_supported: Whole = 3  # most supported objects of a class that rules others out
    min_quality: Real = 0.60  # least quality of a context that rules out
    min_pruning: Real = 0.35  # least pruning of a class in which it does
    min_strength: Real = 0.50  # least strength of such a class
    max_support: Real = 0.10  # relative support above which nothing is ruled out
    max_score: Real = 0.05  # support less contradiction above which nothing is ruled out
    local: Gate = True  # veto by the object's own neighbours
    local_min_quality: Real = 0.45  # least quality of a context for the local veto
    local_min_episodes: Whole = 4  # least episodes of an object that it is applied to
    local_min_seen: Whole = 3  # least plausible objects elsewhere in the frame
    local_min_expected: Whole = 3  # least neighbours to be expected
    local_max_hit_share: Real = 0.10  # veto below this share of expected neighbours in view
    local_mass: Real = 0.75  # summed probability that ends the list of expected neighbours


_S = "association.scores.neighbor_sets"
_I = "association.matching.neighbor_sets_influence"
_V = "association.matching.neighbor_sets_context_veto"

RENAMED: dict[str, str] = {
    f"{_S}.topk_sets": "static.num_hypotheses",
    f"{_S}.beam_width": "static.beam_width",
    f"{_S}.per_class_det_k": "static.class_detections",
    f"{_S}.per_class_pool_k": "static.class_pool",
    f"{_S}.use_mutual": "static.mutual_links",
    f"{_S}.kernel_max": "static.set_kernel",
    f"{_S}.options.obj_Lmax": "static.option_objects",
    f"{_S}.min_set_score": "thresholds.sets.min_set_score",
    f"{_S}.min_edge_p": "thresholds.sets.min_link",
    f"{_S}.density_gate_min_edge_p": "thresholds.sets.drop_weak_links",
    f"{_S}.allow_partial_coverage": "thresholds.sets.partial",
    f"{_S}.max_set_size": "thresholds.sets.max_classes",
    f"{_S}.core.priors_top_m": "thresholds.sets.prior_sets",
    f"{_S}.conf_lambda": "thresholds.sets.maturity_rate",
    f"{_S}.density_edge_cov_gamma": "thresholds.sets.density_power",
    f"{_S}.connectivity_require_min_degree": "thresholds.sets.min_links",
    f"{_S}.connectivity_node_gamma": "thresholds.sets.linked_power",
    f"{_S}.connectivity_edge_gamma": "thresholds.sets.pairs_power",
    f"{_S}.coverage_gamma": "thresholds.sets.coverage_power",
    f"{_S}.coverage_size_boost": "thresholds.sets.coverage_gain",
    f"{_S}.coverage_size_tau": "thresholds.sets.coverage_gain_scale",
    f"{_S}.coverage_explained_beta": "thresholds.sets.explained_scale",
    f"{_S}.exclusivity.enabled": "thresholds.sets.exclusivity",
    f"{_S}.exclusivity.k_min": "thresholds.sets.exclusivity_min_size",
    f"{_S}.exclusivity.maturity_min": "thresholds.sets.exclusivity_min_maturity",
    f"{_S}.exclusivity.eps": "thresholds.sets.exclusivity_eps",
    f"{_S}.size.k_min": "thresholds.sets.size_free",
    f"{_S}.size.tau": "thresholds.sets.size_scale",
    f"{_S}.class_terms.ambig_beta": "thresholds.sets.choice_penalty",
    f"{_S}.class_terms.stability_eps": "thresholds.sets.stability_eps",
    f"{_S}.class_terms.plausible_rel": "thresholds.sets.plausible_share",
    f"{_S}.class_terms.fill_gamma": "thresholds.sets.fill_power",
    f"{_S}.class_terms.info_k_ref": "thresholds.sets.info_reference",
    f"{_S}.class_terms.info_k_gamma": "thresholds.sets.info_power",
    f"{_S}.class_terms.info_k_min_mult": "thresholds.sets.info_weight_min",
    f"{_S}.class_terms.info_k_max_mult": "thresholds.sets.info_weight_max",
    f"{_S}.class_terms.excl_k_ref": "thresholds.sets.exclusivity_reference",
    f"{_S}.class_terms.excl_k_gamma": "thresholds.sets.exclusivity_power",
    f"{_S}.class_terms.excl_k_min_mult": "thresholds.sets.exclusivity_weight_min",
    f"{_S}.class_terms.excl_k_max_mult": "thresholds.sets.exclusivity_weight_max",
    f"{_S}.class_terms.maturity_enabled": "thresholds.sets.maturity",
    f"{_S}.class_terms.maturity_softmin_p": "thresholds.sets.maturity_mean",
    f"{_S}.class_terms.maturity_gamma": "thresholds.sets.maturity_power",
    f"{_S}.weights.coverage": "thresholds.sets.coverage_weight",
    f"{_S}.weights.size": "thresholds.sets.size_weight",
    f"{_S}.weights.density": "thresholds.sets.density_weight",
    f"{_S}.weights.class_info": "thresholds.sets.info_weight",
    f"{_S}.weights.class_support": "thresholds.sets.support_weight",
    f"{_S}.weights.class_stability": "thresholds.sets.stability_weight",
    f"{_S}.weights.exclusivity": "thresholds.sets.exclusivity_weight",
    f"{_S}.core.shortlist_rel": "thresholds.sets.shortlist_loss",
    f"{_I}.enabled": "thresholds.influence.enabled",
    f"{_I}.positive_cap": "thresholds.influence.positive_cap",
    f"{_I}.negative_cap": "thresholds.influence.negative_cap",
    f"{_I}.min_quality": "thresholds.influence.min_quality",
    f"{_I}.rescue_min_sim": "thresholds.influence.rescue_visual",
    f"{_I}.quality.min_best_score": "thresholds.influence.min_best_score",
    f"{_I}.quality.min_coverage_eff": "thresholds.influence.min_coverage",
    f"{_I}.quality.min_size": "thresholds.influence.min_size",
    f"{_I}.quality.size_tau": "thresholds.influence.size_scale",
    f"{_I}.quality.weights.best_score": "thresholds.influence.best_weight",
    f"{_I}.quality.weights.coverage_eff": "thresholds.influence.coverage_weight",
    f"{_I}.quality.weights.maturity": "thresholds.influence.maturity_weight",
    f"{_I}.quality.weights.density": "thresholds.influence.density_weight",
    f"{_I}.quality.weights.size": "thresholds.influence.size_weight",
    f"{_I}.quality.weights.pruning": "thresholds.influence.pruning_weight",
    f"{_I}.support.local_weight": "thresholds.influence.local_weight",
    f"{_I}.support.global_weight": "thresholds.influence.global_weight",
    f"{_I}.support.local_hit_weight": "thresholds.influence.local_hits_weight",
    f"{_I}.support.local_count_weight": "thresholds.influence.local_count_weight",
    f"{_I}.support.local_raw_weight": "thresholds.influence.local_kernel_weight",
    f"{_I}.support.kernel_weight": "thresholds.influence.strength_kernel_weight",
    f"{_I}.support.hyp_weight": "thresholds.influence.strength_prior_weight",
    f"{_I}.support.top_weight": "thresholds.influence.top_weight",
    f"{_I}.support.sum_weight": "thresholds.influence.sum_weight",
    f"{_I}.support.kernel_rel_gamma": "thresholds.influence.kernel_power",
    f"{_I}.support.hyp_rel_gamma": "thresholds.influence.hypothesis_power",
    f"{_I}.support.neutral_rel": "thresholds.influence.neutral",
    f"{_I}.support.min_kernel_abs_for_support": "thresholds.influence.min_kernel",
    f"{_I}.support.min_kernel_hits_for_support": "thresholds.influence.min_hits",
    f"{_I}.support.min_kernel_hit_ratio_for_support": "thresholds.influence.min_hit_share",
    f"{_I}.support.local_min_kernel_abs_for_support": "thresholds.influence.local_min_kernel",
    f"{_I}.support.local_min_kernel_hits_for_support": "thresholds.influence.local_min_hits",
    f"{_I}.support.local_min_kernel_hit_ratio_for_support": (
        "thresholds.influence.local_min_hit_share"
    ),
    f"{_I}.support.band_rel": "thresholds.influence.band",
    f"{_I}.support.soft_band_rel": "thresholds.influence.soft_band",
    f"{_I}.support.soft_band_mix_kernel_weight": "thresholds.influence.soft_kernel_weight",
    f"{_I}.support.soft_band_mix_hyp_weight": "thresholds.influence.soft_hypothesis_weight",
    f"{_I}.support.pruning_weight": "thresholds.influence.pruned_weight",
    f"{_I}.support.rank_weight": "thresholds.influence.rank_weight",
    f"{_I}.support.selectivity_weight": "thresholds.influence.selectivity_weight",
    f"{_I}.contradiction.min_pruning": "thresholds.influence.contradiction_min_pruning",
    f"{_I}.contradiction.min_class_strength": "thresholds.influence.contradiction_min_strength",
    f"{_I}.contradiction.max_rel": "thresholds.influence.contradiction_max_support",
    f"{_V}.enabled": "thresholds.veto.enabled",
    f"{_V}.supported_max": "thresholds.veto.max_supported",
    f"{_V}.min_quality": "thresholds.veto.min_quality",
    f"{_V}.min_pruning": "thresholds.veto.min_pruning",
    f"{_V}.min_class_strength": "thresholds.veto.min_strength",
    f"{_V}.max_compat_rel": "thresholds.veto.max_support",
    f"{_V}.max_score_sets": "thresholds.veto.max_score",
    f"{_V}.local.enabled": "thresholds.veto.local",
    f"{_V}.local.min_quality": "thresholds.veto.local_min_quality",
    f"{_V}.local.min_episodes": "thresholds.veto.local_min_episodes",
    f"{_V}.local.min_kernel_size": "thresholds.veto.local_min_seen",
    f"{_V}.local.min_expected_neighbors": "thresholds.veto.local_min_expected",
    f"{_V}.local.max_hit_ratio": "thresholds.veto.local_max_hit_share",
    f"{_V}.local.expected_mass_target": "thresholds.veto.local_mass",
}

# Lists of names: a gate for each name.
SUBSETS = {
    f"{_I}.allow_status": {
        "STRONG": "thresholds.influence.on_strong",
        "AMBIGUOUS": "thresholds.influence.on_ambiguous",
        "WEAK": "thresholds.influence.on_weak",
    },
}

# Keys that are supported with this value only.
FIXED: dict[str, Any] = {
    f"{_S}.candidate_pair_matrix.enabled": True,
    f"{_S}.candidate_pair_matrix.max_objects": 160,
    f"{_S}.options.det_combo_max": 32,
    f"{_S}.options.det_variants": 2,
    f"{_S}.options.obj_variants": 2,
}

# Keys, or whole sections, that never change an identity in a supported setting.
INERT: tuple[str, ...] = (
    f"{_S}.max_class_options",
    f"{_S}.density_factor",
    f"{_S}.core.selective_classes",
    f"{_S}.context.enabled",
    f"{_S}.context.min_p",
    f"{_S}.context.gamma",
    f"{_S}.context.maturity_tau",
    f"{_S}.beam_state_mode",
    f"{_V}.local.require_supported_alternative",
)
