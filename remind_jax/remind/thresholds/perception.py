"""Thresholds of the perception: what a detection looks like, as a whole, in parts and around it."""

from __future__ import annotations

from remind_jax.numerics.pytree import pytree
from remind_jax.settings.kinds import Gate, Real, Whole
from remind_jax.settings.record import setting

# Where the original keeps these settings.
_O = "object_features"
_KMEANS = "part_descriptors.kmeans"
_ATTENTION = "part_descriptors.attention"
_R = "bg_local"
_PROTOTYPES = "bg_local.prototypes"
_B = "update.background_memory"

# fmt: off


@pytree
class Perception:
    """What each detection looks like.

    Rules: method.md#patch-coverage, method.md#object-descriptors, method.md#k-means-parts,
    method.md#rings.
    """

    patch_coverage: Real = setting(0.0, "a patch belongs to an object if its coverage exceeds this",
        "share of a patch", more="patches at the edge are left out",
        decided_by=("dino.patch_selection", "dino.patch_threshold"))
    global_enabled: Gate = setting(True, "describe and remember the object as a whole",
        decided_by=("object_features.global.enabled", "memory.appearance.enabled",
            "memory.appearance.channels.global.enabled",
            "memory.appearance.channels.patch.enabled"))
    trimmed_enabled: Gate = setting(True, "and by its typical patches",
        decided_by=("object_features.global_trimmed.enabled",
            "memory.appearance.channels.global_trimmed.enabled"))
    trim_keep: Real = setting(0.50, "share of patches kept by the trimmed descriptor",
        "share of the patches", more="less typical patches count; 1: as the global one", symbol="ρ",
        key=f"{_O}.global_trimmed.keep_frac")
    trim_min_patches: Whole = setting(8, "objects with fewer patches are not trimmed", "patches",
        more="only larger objects are trimmed", key=f"{_O}.global_trimmed.min_patches")
    count_patches: Gate = setting(True, "off: every object is as dense as can be",
        key=f"{_O}.patch.enabled")
    max_counted_patches: Whole = setting(512, "cap of the patch count that the density divides by",
        "patches", more="large objects count as less dense", key=f"{_O}.patch.max_patches")
    parts_enabled: Gate = setting(True, "describe parts", decided_by=("part_descriptors.enabled",))
    part_min_patches: Whole = setting(6, "smaller clusters are no parts", "patches",
        more="fewer and larger parts", key=f"{_KMEANS}.min_cluster_patches")
    part_min_support: Real = setting(0.0, "clusters of less summed coverage are no parts",
        "effective patches", more="fewer and better covered parts", key=f"{_KMEANS}.min_support")
    part_merge: Real = setting(0.80, "a part closer than this to a stronger one is dropped",
        "similarity", more="more parts that resemble each other stay", symbol="τ_merge",
        key=f"{_KMEANS}.merge.sim_thr")
    part_trim_keep: Real = setting(0.50, 'static.part_mean "trimmed": share of patches kept',
        "share of the patches", more="less typical patches count",
        key=f"{_KMEANS}.trimmed_keep_frac")
    part_trim_min_patches: Whole = setting(8, "parts with fewer patches are not trimmed", "patches",
        more="only larger parts are trimmed", key=f"{_KMEANS}.trimmed_min_patches")
    kmeans_parts_kept: Gate = setting(True, "remember and compare parts by k-means",
        decided_by=("memory.parts.enabled", "memory.parts.channels.kmeans.enabled"))
    attention_parts_kept: Gate = setting(True, "remember and compare parts by attention",
        decided_by=("memory.parts.channels.attention.enabled",))
    rings_enabled: Gate = setting(True, "describe the background around objects",
        key=f"{_R}.enabled")
    ring_object_coverage: Real = setting(0.0,
        "a patch is object, not background, above this coverage", "share of a patch",
        more="patches at the edge count as background", key=f"{_R}.obj_patch_min_coverage")
    ring_border: Whole = setting(1, "patches left out next to the object", "patches",
        more="less of the object in its background", key=f"{_R}.adaptive.border_exclusion_patches")
    ring_inner: Whole = setting(3, "outer edge of the inner ring in patches", "patches",
        more="the inner ring is wider", symbol="r_in", key=f"{_R}.inner_radius_patches")
    ring_outer: Whole = setting(6, "outer edge of the outer ring in patches", "patches",
        more="the outer ring is wider", symbol="r_out", key=f"{_R}.outer_radius_patches")
    ring_adaptive: Gate = setting(True, "widen rings that hold too few patches",
        key=f"{_R}.adaptive.enabled")
    ring_limit: Whole = setting(10, "patches; widening stops here, at most static.ring_max_radius",
        "patches", more="rings may be widened further", key=f"{_R}.adaptive.max_radius_patches")
    ring_min_inner: Whole = setting(12, "patches that the inner ring should hold", "patches",
        more="the inner ring is widened more often", key=f"{_R}.adaptive.min_inner_patches")
    ring_min_outer: Whole = setting(24, "patches that the outer ring should hold", "patches",
        more="the outer ring is widened more often", key=f"{_R}.adaptive.min_outer_patches")
    ring_nested: Gate = setting(False, "the outer ring contains the inner one",
        key=f"{_R}.ring_mode", theirs={"disjoint": False, "nested": True})


@pytree
class AttentionParts:
    """Regions around the patches that others attend to (method.md#attention-parts).

    Only with `static.part_source` "attention" or "both".
    """

    region_share: Real = setting(0.25, "share of the object's patches in a region",
        "share of the patches", more="larger parts", key=f"{_ATTENTION}.region_frac")
    region_min_patches: Whole = setting(6, "patches in a region, if the object has enough",
        "patches", more="larger parts of small objects", key=f"{_ATTENTION}.min_region_patches")
    region_limit: Real = setting(0.60, "largest share of the object's patches in a region",
        "share of the patches", more="larger parts of small objects are allowed",
        key=f"{_ATTENTION}.max_region_frac")
    trim_keep: Real = setting(0.50, "share of patches kept by trimmed means",
        "share of the patches", more="less typical patches count",
        key=f"{_ATTENTION}.trimmed_keep_frac")
    trim_min_patches: Whole = setting(8, "regions with fewer patches are not trimmed", "patches",
        more="only larger regions are trimmed", key=f"{_ATTENTION}.trimmed_min_patches")


@pytree
class RingPrototypes:
    """How rings are split, remembered and compared.

    Rules: method.md#ring-prototypes, method.md#ring-prototype-learning.

    Only with `static.ring_prototypes`; what is not here follows `background` and `similarity`.
    """

    cluster_scale: Real = setting(1.0,
        "by 'root': clusters per square root of the ring's patches", "clusters",
        more="rings are split finer", key=f"{_PROTOTYPES}.c_sqrt")
    patches_per_cluster: Real = setting(15.0, '"patches": ring patches per cluster', "patches",
        more="rings are split more coarsely", key=f"{_PROTOTYPES}.patches_per_cluster")
    min_cluster_patches: Whole = setting(4, "a ring has at most one cluster per so many patches",
        "patches", more="small rings are split more coarsely",
        key=f"{_PROTOTYPES}.min_pts_per_cluster")
    joined: Real = setting(0.92, "clusters above this similarity are one", "similarity",
        more="more clusters that resemble each other stay", key=f"{_PROTOTYPES}.merge_sim_thr")
    min_mass: Real = setting(0.06, "share of the ring below which a cluster is left out",
        "share of the ring", more="fewer clusters", key=f"{_PROTOTYPES}.min_mass_frac")
    cohesion_power: Real = setting(2.0, "clusters rank by mass times cohesion to this power",
        "exponent", more="uniform clusters come first, before large ones",
        key=f"{_PROTOTYPES}.cohesion_power")
    promote_hits: Whole = setting(5, "hits from which a work prototype feeds the stable bank",
        "hits", more="prototypes are proven longer before they are stable",
        key=f"{_B}.promote_hits_partials")
    stable_merge: Real = setting(0.96, "the closest stable pair is joined from here on",
        "similarity", more="fewer merges, more is evicted instead", key=f"{_B}.stable_merge_thr")
