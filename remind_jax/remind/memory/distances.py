"""How far apart objects are: running means per pair and per three (paper III-D).

Rule: method.md#distance-episodes.

Between two episodes an object collects its relations to the others in view; an episode condenses
them to one value each, by medians in float32. Letters: `N`
detections, `O` object slots, `K` pending relations; the first object axis is the one that
remembers.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.constant_arrays import zeros
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.reductions import reduce_together
from remind_jax.remind.memory.cooccurrence import Sightings
from remind_jax.remind.memory.writing import write_rows
from remind_jax.remind.perception.relations import Contact, Relations
from remind_jax.remind.thresholds.relations import Relations as Rules

PENDING_SLOTS = 3  # a forced episode comes before a fourth relation (method.md#pending-relations)


@pytree
class PendingRelations:
    """Relations since the last episode, the newest K of them, in no order.

    They are read and written together, so they are few arrays.
    """

    measures: Float[Array, "O O 3 K"]  # gap, center distance and support, float32
    kind: Int[Array, "O O K"]  # Contact, `len(Contact)` higher where the gap is valid
    count: Int[Array, "O O"]  # relations seen since the last episode

    @property
    def contact(self) -> Int[Array, "..."]:
        """Contact of each relation."""
        return self.kind % len(Contact)

    @property
    def gap_valid(self) -> Bool[Array, "..."]:
        """Relations whose gap counts."""
        return self.kind >= len(Contact)


@pytree
class Edges:
    """What objects know of single others; means run over episodes (method.md#distance-evidence)."""

    gap_count: Int[Array, "..."]  # episodes with a gap
    contact_count: Int[Array, "... 4"]  # episodes per Contact
    gap_mean: Float[Array, "..."]
    center_mean: Float[Array, "..."]
    support_mean: Float[Array, "..."]

    @property
    def count(self) -> Int[Array, "..."]:
        """Episodes that the edge was built from, 0: no edge."""
        return jnp.sum(self.contact_count, axis=-1, dtype=jnp.int32)


@pytree
class DistanceGraph:
    """Distances around every object (method.md#distance-episodes).

    `nearer` and `margin` hold what an object remembers of two others, `[self, a, b]`. Each pair is
    one entry above and one below the diagonal.
    """

    pending: PendingRelations
    edges: Edges  # leading axes [O O]
    nearer: Int[Array, "O O O"]  # episodes with a nearer than b; of equals the later slot is nearer
    margin: Float[Array, "O O O"]  # difference of both distances; a < b: mean, a > b: squares


def empty_distances(
    num_objects: int, scalar: jnp.dtype, pending_slots: int = PENDING_SLOTS
) -> DistanceGraph:
    """A graph without relations."""
    square, cube = (num_objects,) * 2, (num_objects,) * 3
    return DistanceGraph(
        pending=PendingRelations(
            measures=zeros((*square, 3, pending_slots), np.float32),
            kind=zeros((*square, pending_slots), np.int32),
            count=zeros(square, np.int32),
        ),
        edges=Edges(
            gap_count=zeros(square, np.int32),
            contact_count=zeros((*square, len(Contact)), np.int32),
            gap_mean=zeros(square, scalar),
            center_mean=zeros(square, scalar),
            support_mean=zeros(square, scalar),
        ),
        nearer=zeros(cube, np.int32),
        margin=zeros(cube, scalar),
    )


def update_distances(
    graph: DistanceGraph,
    relations: Relations,
    sightings: Sightings,
    accepted: Bool[Array, "N"],
    t: Rules,
) -> DistanceGraph:
    """Collects the relations of a frame and condenses those of objects that accepted an episode."""
    slots = graph.nearer.shape[0]
    row = jnp.where(t.enabled, sightings.row, slots)
    old = jax.tree.map(lambda leaf: leaf[jnp.minimum(row, slots - 1)], graph)
    pending = _collect(old.pending, relations, sightings)
    episode = _condense(pending)
    takes_part = accepted[:, None] & sightings.visible & (pending.count > 0)
    nearer, margin = _learn_order(old.nearer, old.margin, episode.distance, takes_part)
    new = DistanceGraph(
        pending=dataclasses.replace(pending, count=jnp.where(accepted[:, None], 0, pending.count)),
        edges=_learn_edges(old.edges, episode, takes_part),
        nearer=nearer,
        margin=margin,
    )
    return write_rows(graph, row, new)


def _collect(
    pending: PendingRelations, relations: Relations, sightings: Sightings
) -> PendingRelations:
    """Adds the relations to the other visible objects (method.md#pending-relations).

    Objects that may not make an episode in this frame are left out by those that may, unless
    fewer than two may.
    """
    num = relations.gap.shape[0]
    column = jnp.minimum(sightings.detection, num - 1)
    allowed = sightings.allowed[jnp.minimum(sightings.row, sightings.allowed.shape[0] - 1)]
    few = jnp.sum(sightings.allowed) < 2
    seen = sightings.visible & relations.valid[:, column]
    seen &= ~allowed[:, None] | sightings.allowed | few
    slots = pending.kind.shape[-1]
    at = (pending.count % slots)[..., None] == jnp.arange(slots)
    at &= seen[..., None]
    measures = jnp.stack([relations.gap, relations.center_distance, relations.support], axis=-1)
    kind = relations.contact + len(Contact) * relations.gap_valid
    return PendingRelations(
        measures=jnp.where(
            at[:, :, None],
            measures.astype(jnp.float32)[:, column, :, None],
            pending.measures,
        ),
        kind=jnp.where(at, kind[:, column, None], pending.kind),
        count=pending.count + seen,
    )


@dataclasses.dataclass(frozen=True)
class _Episode:
    """One value per edge from the pending relations, float32."""

    gap: Float[Array, "N O"]
    has_gap: Bool[Array, "N O"]
    center_distance: Float[Array, "N O"]
    support: Float[Array, "N O"]
    contact: Int[Array, "N O"]
    distance: Float[Array, "N O"]


def _condense(pending: PendingRelations) -> _Episode:
    """Medians, mean and usual contact of pending relations (method.md#distance-episodes)."""
    slots = pending.kind.shape[-1]
    live = jnp.arange(slots) < pending.count[..., None]
    size = jnp.clip(pending.count, 1, slots).astype(jnp.float32)
    kinds = jnp.arange(len(Contact))
    votes = jnp.sum(
        (pending.contact[..., None, :] == kinds[:, None]) & live[..., None, :], -1, jnp.int32
    )
    has_gap = live & pending.gap_valid
    gap, center_distance, support = (pending.measures[:, :, i] for i in range(3))
    distance = jnp.where(pending.gap_valid, gap, center_distance)
    medians = _median(
        jnp.stack([gap, center_distance, distance], axis=-2),
        jnp.stack([has_gap, live, live], axis=-2),
    )
    some_gap, total_support = reduce_together(
        ("any", has_gap), ("sum", jnp.where(live, support, 0.0)), axis=-1
    )
    return _Episode(
        gap=medians[..., 0],
        has_gap=some_gap,
        center_distance=medians[..., 1],
        support=total_support / size,
        contact=jnp.argmax(votes * len(Contact) + kinds, axis=-1).astype(jnp.int32),
        distance=medians[..., 2],
    )


def _median(values: Float[Array, "... K"], live: Bool[Array, "... K"]) -> Float[Array, "..."]:
    """Median of the live values, 0 without any; counting is quicker than sorting so few."""
    slots = values.shape[-1]
    size = jnp.sum(live, axis=-1, keepdims=True, dtype=jnp.int32)
    one, other = values[..., :, None], values[..., None, :]
    place = jnp.arange(slots)
    before = (other < one) | ((other == one) & (place < place[:, None]))
    rank = jnp.sum(before & live[..., None, :], axis=-1, dtype=jnp.int32)

    def at(position: Array) -> Array:
        return jnp.where(live & (rank == position), values, 0.0)

    low, high = reduce_together(("sum", at((size - 1) // 2)), ("sum", at(size // 2)), axis=-1)
    return 0.5 * (low + high)


def _learn_edges(edges: Edges, episode: _Episode, takes_part: Bool[Array, "N O"]) -> Edges:
    """Moves the running means by one episode (method.md#distance-episodes)."""
    scalar = edges.gap_mean.dtype
    with_gap = takes_part & episode.has_gap
    gap_count, count = edges.gap_count + with_gap, edges.count + takes_part
    contact = episode.contact[..., None] == np.arange(len(Contact))

    def move(mean: Array, value: Array, number: Array, when: Array) -> Array:
        step = (value.astype(scalar) - mean) / jnp.maximum(1, number).astype(scalar)
        return jnp.where(when, mean + step, mean)

    support = jnp.clip(episode.support, 0.0, 1.0)
    return Edges(
        gap_count=gap_count,
        contact_count=edges.contact_count + (takes_part[..., None] & contact),
        gap_mean=move(edges.gap_mean, episode.gap, gap_count, with_gap),
        center_mean=move(edges.center_mean, episode.center_distance, count, takes_part),
        support_mean=move(edges.support_mean, support, count, takes_part),
    )


def _learn_order(
    nearer: Int[Array, "N O O"],
    margin: Float[Array, "N O O"],
    distance: Float[Array, "N O"],
    takes_part: Bool[Array, "N O"],
) -> tuple[Int[Array, "N O O"], Float[Array, "N O O"]]:
    """Counts which of two others was nearer, and by how much (method.md#distance-episodes)."""
    slot = jnp.arange(nearer.shape[-1])
    upper = slot[:, None] < slot
    both = takes_part[:, :, None] & takes_part[:, None, :] & (slot[:, None] != slot)
    a, b = (distance.astype(margin.dtype)[:, :, None], distance.astype(margin.dtype)[:, None, :])
    wins = both & ((a < b) | ((a == b) & ~upper))
    count = nearer + jnp.swapaxes(nearer, 1, 2) + both
    other = jnp.swapaxes(margin, 1, 2)
    mean, squares = jnp.where(upper, margin, other), jnp.where(upper, other, margin)
    delta = jnp.abs(a - b) - mean
    moved = mean + delta / jnp.maximum(1, count).astype(margin.dtype)
    squares = squares + delta * (jnp.abs(a - b) - moved)
    return nearer + wins, jnp.where(both, jnp.where(upper, moved, squares), margin)


def reorder_distances(
    graph: DistanceGraph, order: Int[Array, "O"], alive: Bool[Array, "O"]
) -> DistanceGraph:
    """Moves objects from the slots in `order`; what is gone is forgotten, by others, too."""
    slots = jnp.arange(order.shape[0])

    def move(leaf: Array) -> Array:
        keep = alive[:, None] & alive
        moved = leaf[order][:, order]
        blank = jnp.zeros((), leaf.dtype)
        return jnp.where(keep.reshape(*keep.shape, *(1,) * (leaf.ndim - 2)), moved, blank)

    def move_cube(leaf: Array) -> Array:
        return jax.lax.map(
            lambda at: jnp.where(alive[at], move(leaf[order[at]]), jnp.zeros((), leaf.dtype)), slots
        )

    def move_all() -> DistanceGraph:
        return DistanceGraph(
            pending=jax.tree.map(move, graph.pending),
            edges=jax.tree.map(move, graph.edges),
            nearer=move_cube(graph.nearer),
            margin=move_cube(graph.margin),
        )

    known = (graph.edges.count > 0) | (graph.pending.count > 0)
    gone = jnp.any(known & ~(alive[:, None] & alive))
    moves = gone | jnp.any(order != slots)
    return branch(moves, move_all, lambda: graph)
