"""Numbers of the parts by attention."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax

from remind_jax.numerics.kinds import Real, Whole


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class AttentionParts:
    """Regions around the patches that others attend to (method.md#attention-parts).

    Only with `static.part_source` "attention" or "both".
    """

    region_share: Real = 0.25  # share of the object's patches in a region
    region_min_patches: Whole = 6  # patches in a region, if the object has enough
    region_limit: Real = 0.60  # largest share of the object's patches in a region
    trim_keep: Real = 0.50  # share of patches kept by trimmed means
    trim_min_patches: Whole = 8  # regions with fewer patches are not trimmed


_P = "part_descriptors.attention"
_MEANS = {False: "plain", True: "trimmed"}

RENAMED: dict[str, str] = {
    f"{_P}.weighted": "static.attention_weighted",
    f"{_P}.trimmed_keep_frac": "thresholds.attention_parts.trim_keep",
    f"{_P}.trimmed_min_patches": "thresholds.attention_parts.trim_min_patches",
    f"{_P}.max_seeds": "static.attention_seeds",
    f"{_P}.region_frac": "thresholds.attention_parts.region_share",
    f"{_P}.min_region_patches": "thresholds.attention_parts.region_min_patches",
    f"{_P}.max_region_frac": "thresholds.attention_parts.region_limit",
}

# Keys whose values have other names here.
CHOICES: dict[str, tuple[str, dict[Any, Any]]] = {
    f"{_P}.use_trimmed_mean": ("static.attention_mean", _MEANS),
    f"{_P}.seed_score": (
        "static.attention_seed",
        {"in_degree": "attended", "out_degree": "attending"},
    ),
}

INERT: tuple[str, ...] = (f"{_P}.return_masks",)
