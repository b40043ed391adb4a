"""`Static`: everything that fixes the shape of the compiled program. Hashable, never traced."""

from __future__ import annotations

import dataclasses
from typing import Literal

import jax.numpy as jnp

from remind_jax.errors import check_fields

GROWTH_STEP = 2  # capacities double when they overflow
_MAY_BE_ZERO = (
    "feature_dim",
    "max_neighbours",
    "first_object_id",
    "part_seed",
    "ring_seed",
    "ring_prototypes_kept",
    "set_kernel",
    "group_anchors",
    "soft_anchors",
    "max_passes",
)


@dataclasses.dataclass(frozen=True)
class Static:
    """Capacities and structural switches; equal values share one compiled program.

    Capacities never change results: when one overflows, it grows and the frame is repeated.
    """

    num_detections: int = 16  # detection slots of a frame; grows
    num_objects: int = 64  # object slots of the memory; grows
    num_pending: int = 32  # slots of ambiguous and of provisional tracks each; grows
    feature_dim: int = 0  # width of the patch features; 0: taken from the backbone
    num_candidates: int = 5  # candidates shown per detection in the decisions
    first_object_id: int = 0  # id of the first object

    precision: Literal["float32", "float64"] = "float32"  # of scores and qualities
    solver: Literal["host", "jax"] = "jax"  # in-graph twins, or SciPy and NumPy by callbacks

    part_clusters: int = 4  # K of the part clustering
    part_iterations: int = 5  # k-means iterations
    part_restarts: int = 2  # k-means restarts
    part_seed: int = 0  # k-means seed
    part_top: int = 3  # best parts that are averaged into the part score
    part_weighted: bool = True  # coverage weighs the patches of a part
    part_mean: Literal["plain", "trimmed"] = "plain"  # over all patches of a part, or typical ones
    part_resembling: Literal["drop", "join", "keep"] = "drop"  # a part like a better supported one
    part_source: Literal["kmeans", "attention", "both"] = "kmeans"  # where parts come from
    part_channel: Literal["best", "kmeans", "attention"] = "best"  # which of them count
    attention_heads: tuple[int, ...] = ()  # heads that attention is averaged over; (): all
    attention_seeds: int = 3  # parts by attention, most
    attention_seed: Literal["attended", "attending"] = "attended"  # what makes a patch matter
    attention_weighted: bool = True  # coverage weighs the patches of a part by attention
    attention_mean: Literal["plain", "trimmed"] = "plain"  # as part_mean, for parts by attention

    global_weighted: bool = True  # coverage weighs the patches of the global descriptor
    trimmed_weighted: bool = True  # coverage weighs the patches of the trimmed descriptor
    ring_max_radius: int = 10  # patches; rings grow up to this distance

    ring_prototypes: bool = False  # describe rings by typical patches as well
    ring_clusters: tuple[int, int] = (4, 24)  # fewest and most clusters of a ring
    ring_cluster_rule: Literal["root", "patches"] = "root"  # how their number grows with the ring
    ring_iterations: int = 10  # k-means iterations
    ring_restarts: int = 1  # k-means restarts
    ring_seed: int = 0  # k-means seed of the inner ring; the outer ring has the next
    ring_prototypes_kept: int = 3  # prototypes of a ring, 0: all
    ring_prototype_kind: Literal["medoid", "centroid"] = "medoid"  # what stands for a cluster
    ring_prototype_top: int = 2  # best prototypes of a ring that are averaged into its score

    appearance_slots: tuple[int, int] = (20, 20)  # prototypes, work and stable bank
    part_slots: tuple[int, int] = (80, 80)  # the same for parts, each channel
    inner_ring_slots: tuple[int, int] = (20, 20)  # the same for the inner ring
    outer_ring_slots: tuple[int, int] = (30, 30)  # the same for the outer ring
    inner_prototype_slots: tuple[int, int] = (60, 60)  # the same for ring prototypes, inner ring
    outer_prototype_slots: tuple[int, int] = (80, 80)  # the same for ring prototypes, outer ring

    appearance_insert: Literal["always", "novel"] = "always"  # what enters the work bank
    appearance_evict: Literal["redundant", "oldest"] = "redundant"  # from a full work bank
    appearance_stable_evict: Literal["redundant", "oldest"] = "redundant"  # from a full stable bank
    appearance_merge: Literal["equal", "capped"] = "equal"  # weights of two merged prototypes
    part_insert: Literal["always", "novel"] = "always"  # what enters the work bank of parts
    part_evict: Literal["redundant", "oldest"] = "oldest"  # from a full work bank of parts
    part_merge: Literal["equal", "capped"] = "capped"  # weights of two merged part prototypes
    ring_evict: Literal["redundant", "oldest"] = "redundant"  # from a full work bank of a ring

    max_neighbours: int = 20  # edges kept per object in the co-occurrence graph
    neighbour_trim: Literal["weight", "recent"] = "weight"  # which edges are kept
    pending_relations: int = 3  # relations of a pair that wait for an episode
    mutual_links: bool = True  # geometric mean of both conditionals, else arithmetic
    class_detections: int = 10  # detections of a class that enter the hypotheses
    class_pool: int = 25  # objects of a class that enter the hypotheses
    set_kernel: int = 6  # objects that speak for a hypothesis; 0: all
    option_objects: int = 8  # objects of a class considered beyond the detections seen
    beam_width: int = 64  # partial hypotheses kept
    num_hypotheses: int = 20  # hypotheses kept
    context_hypotheses: int = 6  # hypotheses that feed the kernel of a class
    expected_neighbours: int = 12  # longest list of expected neighbours

    group_size: int = 4  # largest closed group that is solved by distances
    group_candidates: int = 5  # most candidates of such a group
    group_anchors: int = 3  # surrounding objects that vote in such a group
    soft_anchors: int = 4  # undecided but likely objects that may vote as well
    max_passes: int = 2  # rounds of settling undecided detections

    assignment: Literal["joint", "greedy"] = "joint"  # all pairs at once, or the best pair first
    banks_read: Literal["both", "work"] = "both"  # banks that the similarity reads
    object_channel: Literal["best", "global", "trimmed"] = "best"  # which descriptor is compared
    ring_channel: Literal["combined", "inner", "outer"] = "combined"  # which ring is compared
    # How the lead of the best candidate enters the confidence.
    margin: Literal["sigmoid", "linear", "linear_relative", "sigmoid_relative"] = "sigmoid"
    remove_objects: bool = False  # forget objects that stay away too long

    def __post_init__(self) -> None:
        check_fields(self, "static", may_be_zero=_MAY_BE_ZERO)

    @property
    def part_channels(self) -> tuple[str, ...]:
        """Where parts come from, in the order of their channels."""
        return ("kmeans", "attention") if self.part_source == "both" else (self.part_source,)

    @property
    def scalar(self) -> jnp.dtype:
        """Type of scores, qualities and thresholds."""
        return jnp.dtype(self.precision)

    def grow(self, **needed: int) -> Static:
        """Doubles the named capacities until they hold what is needed."""
        grown = {}
        for name, count in needed.items():
            capacity = getattr(self, name)
            while capacity < count:
                capacity *= GROWTH_STEP
            grown[name] = capacity
        return dataclasses.replace(self, **grown)
