"""Thresholds of the relational memories: what is seen together, and how far apart."""

from __future__ import annotations

from remind_jax.numerics.pytree import pytree
from remind_jax.settings.kinds import Gate, Real, Whole
from remind_jax.settings.record import setting

# Where the original keeps these settings.
_N = "memory.neighbors"
_D = "memory.neighbors_distance"

# fmt: off


@pytree
class Cooccurrence:
    """Who is seen with whom (method.md#episodes)."""

    enabled: Gate = setting(True, "remember neighbors at all; off also stops the distances",
        key=f"{_N}.enabled")
    smoothing: Real = setting(0.5, "added to every count of a conditional probability", "episodes",
        more="few episodes prove less", key=f"{_N}.smoothing_alpha")
    same_context: Real = setting(0.85,
        "overlap of two sets of neighbors that are the same context", "share",
        more="contexts are told apart sooner; more episodes", key=f"{_N}.jaccard_thr")
    debounce_frames: Whole = setting(3, "sightings of a new context that make an episode",
        "sightings", more="fewer episodes", key=f"{_N}.debounce_frames")
    force_frames: Whole = setting(3, "frames after which the next sighting is an episode; 0: never",
        "frames", more="fewer episodes", key=f"{_N}.force_episode_every_frames")
    decay: Real = setting(1.0, "share of an edge weight that an episode leaves", "share",
        more="old company is forgotten more slowly; 1: never", key=f"{_N}.decay_per_episode")


@pytree
class Relations:
    """How two things in one frame lie to each other (method.md#relations)."""

    enabled: Gate = setting(True, "remember distances", key=f"{_D}.enabled")
    scale_min_px: Real = setting(40.0, "least length that distances are measured in", "px",
        more="distances of small objects count as smaller", key=f"{_D}.scale_min")
    contact_margin_px: Real = setting(2.0, "gap up to which two masks touch", "px",
        more="more pairs touch", key=f"{_D}.contact_margin_px")
    near: Real = setting(1.25, "normalized gap up to which two masks are near", "object sizes",
        more="more pairs are near", key=f"{_D}.near_thresh_n")
    exact_gap_max: Real = setting(1.75,
        "normalized box gap beyond which the box gap is good enough", "object sizes",
        more="more gaps are measured between masks; more time", key=f"{_D}.exact_gap_max_n")
