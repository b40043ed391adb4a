"""Thresholds of the context: which objects go together here, and what follows for a candidate."""

from __future__ import annotations

from remind_jax.numerics.pytree import pytree
from remind_jax.settings.kinds import Gate, Real, Whole
from remind_jax.settings.record import setting

# Where the original keeps these settings.
_S = "association.scores.neighbor_sets"
_I = "association.matching.neighbor_sets_influence"
_V = "association.matching.neighbor_sets_context_veto"

# fmt: off


@pytree
class Sets:
    """How sets of objects that may be in view are built and scored (method.md#hypotheses)."""

    min_set_score: Real = setting(0.0, "hypotheses below are dropped", "score",
        more="fewer sets are weighed", key=f"{_S}.min_set_score")
    min_link: Real = setting(0.05,
        "conditional probability from which an object speaks for another", "probability",
        more="fewer objects speak for each other", key=f"{_S}.min_edge_p")
    drop_weak_links: Gate = setting(True, "links below min_link add nothing to the density",
        key=f"{_S}.density_gate_min_edge_p")
    partial: Gate = setting(True, "a set may leave a class in view unexplained",
        key=f"{_S}.allow_partial_coverage")
    max_classes: Whole = setting(0,
        "classes that sets are built from, those of few objects first; 0: all", "classes",
        more="sets reach classes of more objects; more time", key=f"{_S}.max_set_size")
    prior_sets: Whole = setting(0, "best sets that tell how likely an object is in view; 0: all",
        "sets", more="objects of less likely sets count as likely as well",
        key=f"{_S}.core.priors_top_m")
    maturity_rate: Real = setting(0.25, "maturity is 1 - exp(-rate * episodes)", "per episode",
        more="company is trusted earlier", key=f"{_S}.conf_lambda")
    density_power: Real = setting(1.0, "of the share of linked pairs in the density", "exponent",
        more="sets with missing links lose more", key=f"{_S}.density_edge_cov_gamma")
    min_links: Whole = setting(1, "links that every member needs", "links",
        more="loosely linked sets are left out", key=f"{_S}.connectivity_require_min_degree")
    linked_power: Real = setting(1.5,
        "of the share of members with a link; has an effect only if min_links is 0", "exponent",
        more="sets with single members lose more", key=f"{_S}.connectivity_node_gamma")
    pairs_power: Real = setting(1.0, "of the share of linked pairs in the connection", "exponent",
        more="sets with missing links lose more", key=f"{_S}.connectivity_edge_gamma")
    coverage_power: Real = setting(1.0, "of the share of detections that a set explains",
        "exponent", more="sets that explain little lose more", key=f"{_S}.coverage_gamma")
    coverage_gain: Real = setting(0.35, "extra coverage in frames of many detections", "share",
        more="sets that explain many detections gain more", key=f"{_S}.coverage_size_boost")
    coverage_gain_scale: Real = setting(3.0, "detections over which that gain builds up",
        "detections", more="that gain builds up later", key=f"{_S}.coverage_size_tau")
    explained_scale: Real = setting(1.5,
        "explained detections over which coverage builds up; 0: at once", "detections",
        more="sets that explain few detections lose more", key=f"{_S}.coverage_explained_beta")
    exclusivity: Gate = setting(True, "rate how far the best choice of a class leads",
        key=f"{_S}.exclusivity.enabled")
    exclusivity_min_size: Whole = setting(3, "smallest set that is rated so", "objects",
        more="fewer sets are rated so", key=f"{_S}.exclusivity.k_min")
    exclusivity_min_maturity: Real = setting(0.35, "least mean maturity of a set that is rated so",
        "maturity", more="fewer sets are rated so", key=f"{_S}.exclusivity.maturity_min")
    exclusivity_eps: Real = setting(1e-12, "support up to here is none", "support",
        more="none but to keep out zero", key=f"{_S}.exclusivity.eps")
    size_free: Whole = setting(2, "members that earn nothing for size", "objects",
        more="small sets earn less", key=f"{_S}.size.k_min")
    size_scale: Real = setting(2.0, "further members over which the size term builds up", "objects",
        more="size earns more slowly", key=f"{_S}.size.tau")
    choice_penalty: Real = setting(0.35, "loss per nat of choices within a class", "per nat",
        more="classes with many ways to choose lose more", key=f"{_S}.class_terms.ambig_beta")
    stability_eps: Real = setting(1e-12, "support up to here is none", "support",
        more="none but to keep out zero", key=f"{_S}.class_terms.stability_eps")
    plausible_share: Real = setting(0.75, "of the best support, from which an object is plausible",
        "share", more="fewer objects are plausible", key=f"{_S}.class_terms.plausible_rel")
    fill_power: Real = setting(1.0, "of the share of plausible objects that a choice takes",
        "exponent", more="choices that leave plausible objects out lose more",
        key=f"{_S}.class_terms.fill_gamma")
    info_reference: Real = setting(2.0,
        "set size at which the information term has its full weight", "objects",
        more="the information term counts in larger sets as well",
        key=f"{_S}.class_terms.info_k_ref")
    info_power: Real = setting(0.5, "decline of that weight beyond it", "exponent",
        more="it counts less in large sets", key=f"{_S}.class_terms.info_k_gamma")
    info_weight_min: Real = setting(0.35, "least weight of the information term", "factor",
        more="it counts more in large sets", key=f"{_S}.class_terms.info_k_min_mult")
    info_weight_max: Real = setting(1.0, "largest weight of the information term", "factor",
        more="it counts more in small sets", key=f"{_S}.class_terms.info_k_max_mult")
    exclusivity_reference: Real = setting(3.0, "the same of the exclusivity term", "objects",
        more="the exclusivity counts in larger sets as well", key=f"{_S}.class_terms.excl_k_ref")
    exclusivity_power: Real = setting(0.5, "decline of its weight beyond that size", "exponent",
        more="it counts less in large sets", key=f"{_S}.class_terms.excl_k_gamma")
    exclusivity_weight_min: Real = setting(0.35, "least weight of the exclusivity term", "factor",
        more="it counts more in large sets", key=f"{_S}.class_terms.excl_k_min_mult")
    exclusivity_weight_max: Real = setting(1.0, "largest weight of the exclusivity term", "factor",
        more="it counts more in small sets", key=f"{_S}.class_terms.excl_k_max_mult")
    maturity: Gate = setting(True, "trust sets of mature objects more",
        key=f"{_S}.class_terms.maturity_enabled")
    maturity_mean: Real = setting(-3.0, "exponent of the power mean over the members; 0: geometric",
        "exponent", more="a young member harms its set less",
        key=f"{_S}.class_terms.maturity_softmin_p")
    maturity_power: Real = setting(0.85, "of that mean in the score of a set", "exponent",
        more="young sets lose more", key=f"{_S}.class_terms.maturity_gamma")
    coverage_weight: Real = setting(0.40, "share of the coverage in the score of a set", "weight",
        more="sets that explain more come first", key=f"{_S}.weights.coverage")
    size_weight: Real = setting(0.20, "share of the size term", "weight",
        more="larger sets come first", key=f"{_S}.weights.size")
    density_weight: Real = setting(0.20, "share of the density", "weight",
        more="closely linked sets come first", key=f"{_S}.weights.density")
    info_weight: Real = setting(0.10, "share of the information term", "weight",
        more="sets with few alternatives come first", key=f"{_S}.weights.class_info")
    support_weight: Real = setting(0.10, "share of the support within classes", "weight",
        more="supported sets come first", key=f"{_S}.weights.class_support")
    stability_weight: Real = setting(0.10, "share of the stability within classes", "weight",
        more="sets with clear choices come first", key=f"{_S}.weights.class_stability")
    exclusivity_weight: Real = setting(0.05, "share of the exclusivity term", "weight",
        more="sets without rivals come first", key=f"{_S}.weights.exclusivity")
    shortlist_loss: Real = setting(0.10,
        "loss against the best score up to which members are short-listed", "score",
        more="more members are short-listed", key=f"{_S}.core.shortlist_rel")


@pytree
class Influence:
    """What the context adds to or takes from a candidate.

    Rules: method.md#class-summary, method.md#cooccurrence-bonus.
    """

    enabled: Gate = setting(True, "context at all; off also stops rescue and vetoes",
        key=f"{_I}.enabled")
    on_strong: Gate = setting(False, "change scores of detections whose evidence is strong",
        key=f"{_I}.allow_status", listed="STRONG")
    on_ambiguous: Gate = setting(True, "change scores of detections whose evidence is ambiguous",
        key=f"{_I}.allow_status", listed="AMBIGUOUS")
    on_weak: Gate = setting(True, "change scores of detections whose evidence is weak",
        key=f"{_I}.allow_status", listed="WEAK")
    positive_cap: Real = setting(0.20, "largest bonus", "score",
        more="context can save more matches", symbol="δ_+", key=f"{_I}.positive_cap")
    negative_cap: Real = setting(0.10, "largest penalty", "score",
        more="context can prevent more matches", symbol="δ_−", key=f"{_I}.negative_cap")
    min_quality: Real = setting(0.35, "least quality of a context that counts", "quality",
        more="context counts in fewer frames", key=f"{_I}.min_quality")
    rescue_visual: Real = setting(0.60, "least visual score of a pair that a bonus may rescue",
        "score", more="fewer pairs can be rescued", symbol="τ_vis,min", key=f"{_I}.rescue_min_sim")
    min_best_score: Real = setting(0.45, "least score of the best set of a context that counts",
        "score", more="context counts in fewer frames", key=f"{_I}.quality.min_best_score")
    min_coverage: Real = setting(0.35, "least coverage of that set", "share",
        more="context counts in fewer frames", key=f"{_I}.quality.min_coverage_eff")
    min_size: Whole = setting(2, "least size of that set", "objects",
        more="context counts in fewer frames", key=f"{_I}.quality.min_size")
    size_scale: Real = setting(3.0, "members over which the size term of the quality builds up",
        "objects", more="small sets make less quality", key=f"{_I}.quality.size_tau")
    best_weight: Real = setting(0.25, "share of the best set's score in the quality of a context",
        "weight", more="it decides the quality more", key=f"{_I}.quality.weights.best_score")
    coverage_weight: Real = setting(0.20, "share of its coverage", "weight",
        more="it decides the quality more", key=f"{_I}.quality.weights.coverage_eff")
    maturity_weight: Real = setting(0.15, "share of its maturity", "weight",
        more="it decides the quality more", key=f"{_I}.quality.weights.maturity")
    density_weight: Real = setting(0.10, "share of its density", "weight",
        more="it decides the quality more", key=f"{_I}.quality.weights.density")
    size_weight: Real = setting(0.15, "share of its size", "weight",
        more="it decides the quality more", key=f"{_I}.quality.weights.size")
    pruning_weight: Real = setting(0.15, "share of how many candidates it rules out", "weight",
        more="it decides the quality more", key=f"{_I}.quality.weights.pruning")
    local_weight: Real = setting(0.65, "share of the support by the surroundings", "weight",
        more="the surroundings decide more", key=f"{_I}.support.local_weight")
    global_weight: Real = setting(0.35, "share of the support by the rank within the class",
        "weight", more="the rank within the class decides more", key=f"{_I}.support.global_weight")
    local_hits_weight: Real = setting(0.60, "share of the hits in the local support", "weight",
        more="it decides the local support more", key=f"{_I}.support.local_hit_weight")
    local_count_weight: Real = setting(0.20, "share of their number in it", "weight",
        more="it decides the local support more", key=f"{_I}.support.local_count_weight")
    local_kernel_weight: Real = setting(0.20, "share of their strength in it", "weight",
        more="it decides the local support more", key=f"{_I}.support.local_raw_weight")
    strength_kernel_weight: Real = setting(0.75, "share of the kernel in the strength of a class",
        "weight", more="it decides the strength more", key=f"{_I}.support.kernel_weight")
    strength_prior_weight: Real = setting(0.25, "share of the hypotheses in it", "weight",
        more="it decides the strength more", key=f"{_I}.support.hyp_weight")
    top_weight: Real = setting(0.65,
        "share of the best hypothesis in the relative rank by hypotheses", "weight",
        more="the best hypothesis decides more", key=f"{_I}.support.top_weight")
    sum_weight: Real = setting(0.35, "share of all hypotheses in it", "weight",
        more="the other hypotheses decide more", key=f"{_I}.support.sum_weight")
    kernel_power: Real = setting(0.75, "compresses relative support by the kernel", "exponent",
        more="weaker support counts less", key=f"{_I}.support.kernel_rel_gamma")
    hypothesis_power: Real = setting(0.75, "compresses relative support by hypotheses", "exponent",
        more="weaker support counts less", key=f"{_I}.support.hyp_rel_gamma")
    neutral: Real = setting(0.20, "relative support that earns nothing", "support",
        more="smaller bonuses", key=f"{_I}.support.neutral_rel")
    min_kernel: Real = setting(0.10, "least absolute support by the kernel", "support",
        more="fewer objects are supported", key=f"{_I}.support.min_kernel_abs_for_support")
    min_hits: Whole = setting(2, "least members of the kernel that speak for the object", "objects",
        more="fewer objects are supported", key=f"{_I}.support.min_kernel_hits_for_support")
    min_hit_share: Real = setting(0.25, "least share of the kernel that does", "share",
        more="fewer objects are supported", key=f"{_I}.support.min_kernel_hit_ratio_for_support")
    local_min_kernel: Real = setting(0.10, "as min_kernel, for local support", "support",
        more="fewer objects have local support",
        key=f"{_I}.support.local_min_kernel_abs_for_support")
    local_min_hits: Whole = setting(2, "as min_hits, for local support", "objects",
        more="fewer objects have local support",
        key=f"{_I}.support.local_min_kernel_hits_for_support")
    local_min_hit_share: Real = setting(0.25, "as min_hit_share, for local support", "share",
        more="fewer objects have local support",
        key=f"{_I}.support.local_min_kernel_hit_ratio_for_support")
    band: Real = setting(0.80, "of the best relative support, from which an object is supported",
        "share", more="fewer objects are supported", key=f"{_I}.support.band_rel")
    soft_band: Real = setting(0.65, "of the best mixed support, from which it is softly supported",
        "share", more="fewer objects are softly supported", key=f"{_I}.support.soft_band_rel")
    soft_kernel_weight: Real = setting(0.70, "share of the kernel in the mixed support", "weight",
        more="it decides the mixed support more", key=f"{_I}.support.soft_band_mix_kernel_weight")
    soft_hypothesis_weight: Real = setting(0.30, "share of the hypotheses in it", "weight",
        more="it decides the mixed support more", key=f"{_I}.support.soft_band_mix_hyp_weight")
    pruned_weight: Real = setting(0.55, "share of the pruning in the global support", "weight",
        more="it decides the global support more", key=f"{_I}.support.pruning_weight")
    rank_weight: Real = setting(0.30, "share of the rank in it", "weight",
        more="it decides the global support more", key=f"{_I}.support.rank_weight")
    selectivity_weight: Real = setting(0.15, "share of the selectivity in it", "weight",
        more="it decides the global support more", key=f"{_I}.support.selectivity_weight")
    contradiction_min_pruning: Real = setting(0.35, "least pruning of a class that can contradict",
        "share", more="fewer contradictions", key=f"{_I}.contradiction.min_pruning")
    contradiction_min_strength: Real = setting(0.35, "least strength of such a class", "strength",
        more="fewer contradictions", key=f"{_I}.contradiction.min_class_strength")
    contradiction_max_support: Real = setting(0.10, "largest relative support that is contradicted",
        "support", more="more contradictions", key=f"{_I}.contradiction.max_rel")


@pytree
class Veto:
    """When the context rules a pair out (method.md#veto)."""

    enabled: Gate = setting(True, "pairs may be ruled out", key=f"{_V}.enabled")
    max_supported: Whole = setting(3, "most supported objects of a class that rules others out",
        "objects", more="more vetoes", key=f"{_V}.supported_max")
    min_quality: Real = setting(0.60, "least quality of a context that rules out", "quality",
        more="fewer vetoes", key=f"{_V}.min_quality")
    min_pruning: Real = setting(0.35, "least pruning of a class in which it does", "share",
        more="fewer vetoes", key=f"{_V}.min_pruning")
    min_strength: Real = setting(0.50, "least strength of such a class", "strength",
        more="fewer vetoes", key=f"{_V}.min_class_strength")
    max_support: Real = setting(0.10, "relative support above which nothing is ruled out",
        "support", more="more vetoes", key=f"{_V}.max_compat_rel")
    max_score: Real = setting(0.05, "support less contradiction above which nothing is ruled out",
        "support", more="more vetoes", key=f"{_V}.max_score_sets")
    local: Gate = setting(True, "veto by the object's own neighbors", key=f"{_V}.local.enabled")
    local_min_quality: Real = setting(0.45, "least quality of a context for the local veto",
        "quality", more="fewer local vetoes", key=f"{_V}.local.min_quality")
    local_min_episodes: Whole = setting(4, "least episodes of an object that it is applied to",
        "episodes", more="fewer local vetoes", key=f"{_V}.local.min_episodes")
    local_min_seen: Whole = setting(3, "least plausible objects elsewhere in the frame", "objects",
        more="fewer local vetoes", key=f"{_V}.local.min_kernel_size")
    local_min_expected: Whole = setting(3, "least neighbors to be expected", "objects",
        more="fewer local vetoes", key=f"{_V}.local.min_expected_neighbors")
    local_max_hit_share: Real = setting(0.10,
        "veto below this share of expected neighbors in view", "share", more="more local vetoes",
        key=f"{_V}.local.max_hit_ratio")
    local_mass: Real = setting(0.75, "summed probability that ends the list of expected neighbors",
        "probability", more="more neighbors are expected", key=f"{_V}.local.expected_mass_target")
