"""Numbers of the ring prototypes: typical patches of the background around an object."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax

from remind_jax.numerics.kinds import Real, Whole


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class RingPrototypes:
    """How rings are split, remembered and compared.

    Rules: method.md#ring-prototypes, method.md#ring-prototype-learning.

    Only with `static.ring_prototypes`; what is not here follows `background` and `similarity`.
    """

    cluster_scale: Real = 1.0  # "root": clusters per square root of the ring's patches
    patches_per_cluster: Real = 15.0  # "patches": ring patches per cluster
    min_cluster_patches: Whole = 4  # a ring has at most one cluster per so many patches
    joined: Real = 0.92  # clusters above this similarity are one
    min_mass: Real = 0.06  # share of the ring below which a cluster is left out
    cohesion_power: Real = 2.0  # clusters rank by mass times cohesion to this power
    promote_hits: Whole = 5  # hits from which a work prototype feeds the stable bank
    stable_merge: Real = 0.96  # the closest stable pair is joined from here on


_P = "bg_local.prototypes"
_W = "association.matching.weights"

RENAMED: dict[str, str] = {
    f"{_P}.c_sqrt": "thresholds.ring_prototypes.cluster_scale",
    f"{_P}.patches_per_cluster": "thresholds.ring_prototypes.patches_per_cluster",
    f"{_P}.min_pts_per_cluster": "thresholds.ring_prototypes.min_cluster_patches",
    f"{_P}.merge_sim_thr": "thresholds.ring_prototypes.joined",
    f"{_P}.min_mass_frac": "thresholds.ring_prototypes.min_mass",
    f"{_P}.cohesion_power": "thresholds.ring_prototypes.cohesion_power",
    f"{_P}.top_n": "static.ring_prototypes_kept",
    f"{_P}.iters": "static.ring_iterations",
    f"{_P}.n_init": "static.ring_restarts",
    f"{_P}.seed": "static.ring_seed",
    "update.background_memory.promote_hits_partials": "thresholds.ring_prototypes.promote_hits",
    "update.background_memory.stable_merge_thr": "thresholds.ring_prototypes.stable_merge",
    "association.similarity.background_partials.topk": "static.ring_prototype_top",
    f"{_W}.background_partials": "thresholds.similarity.ring_prototypes_weight",
}

# Keys whose values have other names here.
CHOICES: dict[str, tuple[str, dict[Any, Any]]] = {
    f"{_P}.k_mode": ("static.ring_cluster_rule", {"sqrt": "root", "ppc": "patches"}),
    f"{_P}.proto_mode": (
        "static.ring_prototype_kind",
        {"medoid": "medoid", "centroid": "centroid"},
    ),
}

# Places in pairs.
SLOTS: dict[str, tuple[tuple[str, int], ...]] = {
    f"{_P}.k_min": (("static.ring_clusters", 0),),
    f"{_P}.k_max": (("static.ring_clusters", 1),),
    "memory.background.max_inner_partials": (("static.inner_prototype_slots", 0),),
    "memory.background.max_outer_partials": (("static.outer_prototype_slots", 0),),
    "memory.background.max_inner_partials_stable": (("static.inner_prototype_slots", 1),),
    "memory.background.max_outer_partials_stable": (("static.outer_prototype_slots", 1),),
}
