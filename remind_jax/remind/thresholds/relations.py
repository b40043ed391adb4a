"""Numbers of the relational memories: which objects go together, and how far apart they are."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax

from remind_jax.numerics.kinds import Gate, Real, Whole


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Cooccurrence:
    """Who is seen with whom (method.md#episodes)."""

    enabled: Gate = True  # remember neighbours at all; off also stops the distances
    smoothing: Real = 0.5  # added to every count of a conditional probability
    same_context: Real = 0.85  # overlap of two sets of neighbours that are the same context
    debounce_frames: Whole = 3  # sightings of a new context that make an episode
    force_frames: Whole = 3  # frames after which the next sighting is an episode; 0: never
    decay: Real = 1.0  # share of an edge weight that an episode leaves


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Relations:
    """How two things in one frame lie to each other (method.md#relations)."""

    enabled: Gate = True  # remember distances
    scale_min_px: Real = 40.0  # least length that distances are measured in
    contact_margin_px: Real = 2.0  # gap up to which two masks touch
    near: Real = 1.25  # normalised gap up to which two masks are near
    exact_gap_max: Real = 1.75  # normalised box gap beyond which the box gap is good enough


RENAMED: dict[str, str] = {
    "memory.neighbors.enabled": "thresholds.cooccurrence.enabled",
    "memory.neighbors.smoothing_alpha": "thresholds.cooccurrence.smoothing",
    "memory.neighbors.jaccard_thr": "thresholds.cooccurrence.same_context",
    "memory.neighbors.debounce_frames": "thresholds.cooccurrence.debounce_frames",
    "memory.neighbors.force_episode_every_frames": "thresholds.cooccurrence.force_frames",
    "memory.neighbors.decay_per_episode": "thresholds.cooccurrence.decay",
    "memory.neighbors.max_neighbors": "static.max_neighbours",
    "memory.neighbors_distance.enabled": "thresholds.relations.enabled",
    "memory.neighbors_distance.scale_min": "thresholds.relations.scale_min_px",
    "memory.neighbors_distance.contact_margin_px": "thresholds.relations.contact_margin_px",
    "memory.neighbors_distance.near_thresh_n": "thresholds.relations.near",
    "memory.neighbors_distance.exact_gap_max_n": "thresholds.relations.exact_gap_max",
}

# Keys whose values have other names here.
CHOICES: dict[str, tuple[str, dict[Any, Any]]] = {
    "memory.neighbors.trim_strategy": (
        "static.neighbour_trim",
        {"weight": "weight", "recent": "recent"},
    ),
}

# Keys without effect on an identity.
INERT: tuple[str, ...] = ("memory.neighbors_distance.var_floor",)
