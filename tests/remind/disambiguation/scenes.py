"""Frozen scenes with look-alikes, and what the reference rules make of them.

The scenes were drawn at random (look-alikes, histories, virtual objects, second matches of an
object); the answers are those of an independent plain implementation of the rules that
agrees with the original. `expected.*` is by detection or by the
root of a group; `expected.numbers` is score, gap, core, core gap and evidence.
"""

import dataclasses
import functools
from typing import Any

import jax
import numpy as np

from remind_jax.remind.association.gating import Pairs, initial_pairs
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.disambiguation.known_sets import settle_known_sets
from remind_jax.remind.memory.distances import DistanceGraph, Edges, empty_distances
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.known_sets import KnownSets
from remind_jax.static import Static
from tests.golden.load import load_cases
from tests.statics import make_static

GOLDEN = "disambiguation/known_sets"
NUM_OBJECTS = 8
STATIC = make_static(precision="float64")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Scene:
    undecided: Any
    class_id: Any
    matched_slot: Any
    matched_pass: Any
    candidate: Any
    pairs: Any
    object_exists: Any
    relations: Any
    graph: Any


def load_scenes() -> Scene:
    """All scenes, with a leading axis."""
    read = load_cases(GOLDEN).__getitem__
    low, high = np.triu_indices(NUM_OBJECTS, 1)

    def unfold(above: np.ndarray, below: np.ndarray) -> np.ndarray:
        cube = np.zeros((*above.shape[:-1], NUM_OBJECTS, NUM_OBJECTS), above.dtype)
        cube[..., low, high], cube[..., high, low] = above, below
        return cube

    first = read("evidence.pair_first")
    nearer = unfold(first, read("evidence.pair_n") - first)
    mean, squares_sum = (read(f"evidence.pair_margin_{name}") for name in ("mean", "m2"))
    return Scene(
        undecided(read("present"), read("candidates")),
        read("class_id"),
        read("matched_slot"),
        read("matched_pass"),
        read("candidate"),
        known_pairs(read("score"), read("eligible")),
        read("object_exists"),
        relations_of(
            read("relations.gap"),
            gap_valid=read("relations.gap_valid"),
            center_distance=read("relations.centre"),
            gap_quality=read("relations.gap_quality"),
            truncated=read("relations.truncation") > 0,
            contact=read("relations.state"),
            support=read("relations.support_like"),
        ),
        graph_of(
            Edges(
                gap_count=read("evidence.gap_n"),
                contact_count=read("evidence.contact"),
                gap_mean=read("evidence.gap_mean"),
                center_mean=read("evidence.centre_mean"),
                support_mean=read("evidence.support_mean"),
            ),
            nearer,
            unfold(mean, squares_sum),
        ),
    )


def undecided(present: Any, slot: Any) -> Undecided:
    """Entries of which only the options matter."""
    slot = np.asarray(slot, np.int32)
    row = np.zeros(slot.shape[:-1], np.int32)
    return Undecided(np.asarray(present), slot, np.zeros(slot.shape), row * 0.0, row)  # pyright: ignore[reportArgumentType]


def known_pairs(score: Any, eligible: Any) -> Pairs:
    """Pairs of which only the known score matters."""
    return dataclasses.replace(jax.vmap(initial_pairs)(score), eligible=eligible)


def relations_of(gap: Any, **changed: Any) -> Relations:
    """Detections that lie apart by these gaps `[... N N]`, clearly seen."""
    gap = np.asarray(gap)
    leaves: dict[str, Any] = {
        "gap": gap,
        "center_distance": gap,
        "contact": np.zeros(gap.shape, np.int32),
        "support": np.zeros_like(gap),
        "gap_valid": np.ones(gap.shape, bool),
        "gap_quality": np.ones_like(gap),
        "truncated": np.zeros(gap.shape, bool),
        "valid": np.broadcast_to(~np.eye(gap.shape[-1], dtype=bool), gap.shape),
    }
    return Relations(**{**leaves, **changed})


def graph_of(edges: Edges, nearer: Any, margin: Any) -> DistanceGraph:
    """A memory of distances, without relations that wait for an episode."""
    pending = empty_distances(1, np.dtype("float64")).pending
    waiting = jax.tree.map(lambda leaf: np.zeros((*nearer.shape[:-3], *leaf.shape)), pending)
    return DistanceGraph(waiting, edges, nearer, margin)


def thresholds(**changes: Any) -> KnownSets:
    return Thresholds(known_sets=KnownSets(**changes)).as_arrays(STATIC.scalar).known_sets


@functools.partial(jax.jit, static_argnames="static")
def settle_all(scenes: Scene, t: KnownSets, static: Static) -> Any:
    """Settles all scenes of a batch."""

    def one(scene: Scene) -> Any:
        return settle_known_sets(
            **{field.name: getattr(scene, field.name) for field in dataclasses.fields(scene)},
            static=static,
            t=t,
        )

    return jax.vmap(one)(scenes)


def settle_scenes(scenes: Scene, static: Static = STATIC, **changes: Any) -> Any:
    return jax.device_get(settle_all(scenes, thresholds(**changes), static))
