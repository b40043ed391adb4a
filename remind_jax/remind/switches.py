"""`Switches`: what fixes the compiled program of the paper's tracker beside its capacities."""

from __future__ import annotations

import dataclasses
from typing import Literal

from remind_jax.errors import ConfigError
from remind_jax.settings.ranges import check_fields
from remind_jax.settings.record import setting

# Where the original keeps these settings.
_ATTENTION = "part_descriptors.attention"
_KMEANS = "part_descriptors.kmeans"
_RINGS = "bg_local.prototypes"
_MB = "memory.background"
_MA = "memory.appearance"
_M = "association.matching"
_K = "association.ambiguous_tracks.known_set_distance_disambiguation"
_S = "association.scores.neighbor_sets"
_A = "update.appearance_memory"
_P = "update.parts_memory"

_ROOM = "more views are remembered; more memory and time"
_INSERT = {"always": "always", "novel_only": "novel"}
_EVICT = {"redundant": "redundant", "lru": "oldest"}
_WEIGHT = {"equal": "equal", "count_capped": "capped"}
_MEAN = {False: "plain", True: "trimmed"}

# fmt: off


@dataclasses.dataclass(frozen=True)
class Switches:
    """Structural switches of the paper's tracker; equal values share one compiled program."""

    part_clusters: int = setting(4, "K of the part clustering", "clusters",
        more="more and smaller parts", key=f"{_KMEANS}.k")
    part_iterations: int = setting(5, "k-means iterations", "iterations",
        more="more settled parts, more time", key=f"{_KMEANS}.iters")
    part_restarts: int = setting(2, "k-means restarts", "restarts", more="better parts, more time",
        key=f"{_KMEANS}.n_init")
    part_seed: int = setting(0, "k-means seed", "seed", more="another draw of the first centers",
        least=0, key=f"{_KMEANS}.seed")
    part_top: int = setting(3, "best parts that are averaged into the part score", "parts",
        more="more parts must be found again", key="association.similarity.parts.topk")
    part_weighted: bool = setting(True, "coverage weighs the patches of a part",
        key=f"{_KMEANS}.weighted")
    part_mean: Literal["plain", "trimmed"] = setting("plain",
        "over all patches of a part, or typical ones", key=f"{_KMEANS}.use_trimmed_mean",
        theirs=_MEAN)
    part_resembling: Literal["drop", "join", "keep"] = setting("drop",
        "a part like a better supported one",
        decided_by=("part_descriptors.kmeans.merge.enabled", "part_descriptors.kmeans.merge.mode"))
    part_source: Literal["kmeans", "attention", "both"] = setting("kmeans", "where parts come from",
        decided_by=("part_descriptors.kmeans.enabled", "part_descriptors.attention.enabled"))
    part_channel: Literal["best", "kmeans", "attention"] = setting("best", "which of them count",
        key=f"{_M}.parts_mode",
        theirs={"max": "best", "kmeans": "kmeans", "attention": "attention"})
    attention_heads: tuple[int, ...] = setting((), "heads that attention is averaged over; (): all",
        decided_by=("part_descriptors.attention.head_ids",))
    attention_seeds: int = setting(3, "parts by attention, most", "parts", more="more parts",
        key=f"{_ATTENTION}.max_seeds")
    attention_seed: Literal["attended", "attending"] = setting("attended",
        "what makes a patch matter", key=f"{_ATTENTION}.seed_score",
        theirs={"in_degree": "attended", "out_degree": "attending"})
    attention_weighted: bool = setting(True, "coverage weighs the patches of a part by attention",
        key=f"{_ATTENTION}.weighted")
    attention_mean: Literal["plain", "trimmed"] = setting("plain",
        "as part_mean, for parts by attention", key=f"{_ATTENTION}.use_trimmed_mean", theirs=_MEAN)

    global_weighted: bool = setting(True, "coverage weighs the patches of the global descriptor",
        key="object_features.global.weighted")
    trimmed_weighted: bool = setting(True, "coverage weighs the patches of the trimmed descriptor",
        key="object_features.global_trimmed.weighted")
    ring_max_radius: int = setting(10, "patches; rings grow up to this distance", "patches",
        more="rings may be widened further; more time")

    ring_prototypes: bool = setting(False, "describe rings by typical patches as well",
        decided_by=("bg_local.prototypes.enabled",
            "association.similarity.background_partials.enabled"))
    ring_clusters: tuple[int, int] = setting((4, 24), "fewest and most clusters of a ring",
        "clusters: fewest, most", more="rings are split finer",
        key=(f"{_RINGS}.k_min", f"{_RINGS}.k_max"))
    ring_cluster_rule: Literal["root", "patches"] = setting("root",
        "how their number grows with the ring", key=f"{_RINGS}.k_mode",
        theirs={"sqrt": "root", "ppc": "patches"})
    ring_iterations: int = setting(10, "k-means iterations", "iterations",
        more="more settled prototypes, more time", key=f"{_RINGS}.iters")
    ring_restarts: int = setting(1, "k-means restarts", "restarts",
        more="better prototypes, more time", key=f"{_RINGS}.n_init")
    ring_seed: int = setting(0, "k-means seed of the inner ring; the outer ring has the next",
        "seed", more="another draw of the first centers", least=0, key=f"{_RINGS}.seed")
    ring_prototypes_kept: int = setting(3, "prototypes of a ring, 0: all", "prototypes",
        more="more of the ring is remembered", least=0, key=f"{_RINGS}.top_n")
    ring_prototype_kind: Literal["medoid", "centroid"] = setting("medoid",
        "what stands for a cluster", key=f"{_RINGS}.proto_mode",
        theirs={"medoid": "medoid", "centroid": "centroid"})
    ring_prototype_top: int = setting(2,
        "best prototypes of a ring that are averaged into its score", "prototypes",
        more="more of the ring must be found again",
        key="association.similarity.background_partials.topk")

    appearance_slots: tuple[int, int] = setting((20, 20), "prototypes, work and stable bank",
        "prototypes: work, stable", more=_ROOM,
        key=(f"{_MA}.max_prototypes_per_channel", f"{_MA}.max_stable_prototypes_per_channel"))
    part_slots: tuple[int, int] = setting((80, 80), "the same for parts, each channel",
        "prototypes: work, stable", more=_ROOM,
        key=("memory.parts.max_prototypes_per_channel", "memory.parts.max_prototypes_per_channel"))
    inner_ring_slots: tuple[int, int] = setting((20, 20), "the same for the inner ring",
        "prototypes: work, stable", more=_ROOM,
        key=(f"{_MB}.max_inner", f"{_MB}.max_inner_global_stable"))
    outer_ring_slots: tuple[int, int] = setting((30, 30), "the same for the outer ring",
        "prototypes: work, stable", more=_ROOM,
        key=(f"{_MB}.max_outer", f"{_MB}.max_outer_global_stable"))
    inner_prototype_slots: tuple[int, int] = setting((60, 60),
        "the same for ring prototypes, inner ring", "prototypes: work, stable", more=_ROOM,
        key=(f"{_MB}.max_inner_partials", f"{_MB}.max_inner_partials_stable"))
    outer_prototype_slots: tuple[int, int] = setting((80, 80),
        "the same for ring prototypes, outer ring", "prototypes: work, stable", more=_ROOM,
        key=(f"{_MB}.max_outer_partials", f"{_MB}.max_outer_partials_stable"))

    appearance_insert: Literal["always", "novel"] = setting("always", "what enters the work bank",
        key=f"{_A}.insert_policy", theirs=_INSERT)
    appearance_evict: Literal["redundant", "oldest"] = setting("redundant", "from a full work bank",
        key=f"{_A}.evict_strategy", theirs=_EVICT)
    appearance_stable_evict: Literal["redundant", "oldest"] = setting("redundant",
        "from a full stable bank", key=f"{_A}.stable_evict_strategy", theirs=_EVICT)
    appearance_merge: Literal["equal", "capped"] = setting("equal",
        "weights of two merged prototypes", key=f"{_A}.merge_weight", theirs=_WEIGHT)
    part_insert: Literal["always", "novel"] = setting("always",
        "what enters the work bank of parts", key=f"{_P}.insert_policy", theirs=_INSERT)
    part_evict: Literal["redundant", "oldest"] = setting("oldest", "from a full work bank of parts",
        key=f"{_P}.evict_strategy", theirs=_EVICT)
    part_merge: Literal["equal", "capped"] = setting("capped",
        "weights of two merged part prototypes", key=f"{_P}.merge.merge_weight", theirs=_WEIGHT)
    ring_evict: Literal["redundant", "oldest"] = setting("redundant",
        "from a full work bank of a ring", key="update.background_memory.work_evict_strategy",
        theirs=_EVICT)

    max_neighbours: int = setting(20, "edges kept per object in the co-occurrence graph", "objects",
        more="company seen long ago is remembered", least=0, key="memory.neighbors.max_neighbors")
    neighbour_trim: Literal["weight", "recent"] = setting("weight", "which edges are kept",
        key="memory.neighbors.trim_strategy", theirs={"weight": "weight", "recent": "recent"})
    pending_relations: int = setting(3, "relations of a pair that wait for an episode", "relations",
        more="more distances reach an episode")
    mutual_links: bool = setting(True, "geometric mean of both conditionals, else arithmetic",
        key=f"{_S}.use_mutual")
    class_detections: int = setting(10, "detections of a class that enter the hypotheses",
        "detections", more="crowded classes are searched in full; more time",
        key=f"{_S}.per_class_det_k")
    class_pool: int = setting(25, "objects of a class that enter the hypotheses", "objects",
        more="large classes are searched in full; more time", key=f"{_S}.per_class_pool_k")
    set_kernel: int = setting(6, "objects that speak for a hypothesis; 0: all", "objects",
        more="more objects have a say about a set", least=0, key=f"{_S}.kernel_max")
    option_objects: int = setting(8, "objects of a class considered beyond the detections seen",
        "objects", more="more choices within a class; more time", key=f"{_S}.options.obj_Lmax")
    beam_width: int = setting(64, "partial hypotheses kept", "sets",
        more="a more thorough search; more time", key=f"{_S}.beam_width")
    num_hypotheses: int = setting(20, "hypotheses kept", "sets", more="more sets are weighed",
        key=f"{_S}.topk_sets")
    context_hypotheses: int = setting(6, "hypotheses that feed the kernel of a class", "sets",
        more="less likely sets have a say as well",
        decided_by=("association.scores.neighbor_sets.context.k",))
    expected_neighbours: int = setting(12, "longest list of expected neighbors", "objects",
        more="more company is asked for",
        decided_by=("association.scores.neighbor_sets.context.k",
            "association.matching.neighbor_sets_context_veto.local.expected_topk_scale"))

    group_size: int = setting(4, "largest closed group that is solved by distances", "detections",
        more="larger groups are told apart; much more time", key=f"{_K}.max_group_size",
        most=6, why="as all ways to give them their objects are weighed")
    group_candidates: int = setting(5, "most candidates of such a group", "objects",
        more="groups with more candidates are told apart; more time",
        key=f"{_K}.max_candidate_union", most=8,
        why="as all ways to give them to detections are weighed")
    group_anchors: int = setting(3, "surrounding objects that vote in such a group", "objects",
        more="more surrounding objects vote", least=0, key=f"{_K}.discriminative_anchor_topk")
    soft_anchors: int = setting(4, "undecided but likely objects that may vote as well", "objects",
        more="more undecided objects vote", least=0, key=f"{_K}.soft_anchor_max")
    max_passes: int = setting(2, "rounds of settling undecided detections", "rounds",
        more="what one round decides helps in the next", least=0, key=f"{_K}.max_passes")

    assignment: Literal["joint", "greedy"] = setting("joint",
        "all pairs at once, or the best pair first")
    banks_read: Literal["both", "work"] = setting("both", "banks that the similarity reads",
        key=f"{_M}.proto_source_mode", theirs={"default": "both", "work_only": "work"})
    object_channel: Literal["best", "global", "trimmed"] = setting("best",
        "which descriptor is compared", key=f"{_M}.object_mode",
        theirs={"max": "best", "global": "global", "global_trimmed": "trimmed"})
    ring_channel: Literal["combined", "inner", "outer"] = setting("combined",
        "which ring is compared", key=f"{_M}.background_mode",
        theirs={"combined": "combined", "inner": "inner", "outer": "outer"})
    margin: Literal["sigmoid", "linear", "linear_relative", "sigmoid_relative"] = setting("sigmoid",
        "how the lead of the best candidate enters the confidence",
        key="association.confidence.margin_mode",
        theirs={"sigmoid_abs": "sigmoid", "linear_abs": "linear", "linear_rel": "linear_relative",
            "sigmoid_rel": "sigmoid_relative"})
    remove_objects: bool = setting(False, "forget objects that stay away too long",
        key="update.remove_enabled")

    # fmt: on

    def __post_init__(self) -> None:
        check_fields(self, "static.switches")
        fewest, most = self.ring_clusters
        if fewest > most:
            raise ConfigError(
                f"static.switches.ring_clusters is {self.ring_clusters!r}; the first, the fewest, "
                "may not be above the second, the most"
            )

    @property
    def part_channels(self) -> tuple[str, ...]:
        """Where parts come from, in the order of their channels."""
        return ("kmeans", "attention") if self.part_source == "both" else (self.part_source,)
