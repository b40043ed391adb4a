"""Who is seen with whom: every object counts the others around it (paper III-D).

Rule: method.md#episodes.

Objects count episodes, not frames: an episode is a sighting in new surroundings, or after some
time in the same ones. Letters: `N` detections, `O` object slots;
the first object axis is the one that remembers, the second the one remembered.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NEVER
from remind_jax.numerics.constant_arrays import full, zeros
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import largest, rank_rising
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import divide
from remind_jax.numerics.set_order import copied_size, iteration_rank
from remind_jax.remind.thresholds.relations import Cooccurrence as Rules
from remind_jax.static import Static

_TINY = 1e-12


@pytree
class CooccurrenceGraph:
    """Episodes of every object and its edges to others (method.md#episodes)."""

    episodes: Int[Array, "O"]  # accepted episodes
    last_episode: Int[Array, "O"]  # frame of the last one, -1 before the first
    context: Bool[Array, "O O"]  # who was around in the last episode
    pending_context: Bool[Array, "O O"]  # other surroundings that may become an episode
    pending_hits: Int[Array, "O"]  # sightings in them, 0: there are none
    count: Int[Array, "O O"]  # episodes together, 0: no edge
    weight: Float[Array, "O O"]  # the same, decayed
    edge_time: Int[Array, "O O"]  # frame of the last episode together
    edge_order: Int[Array, "O O"]  # rises in the order in which the edges were made


@pytree
class Sightings:
    """Which objects a frame shows, each by one detection."""

    row: Int[Array, "N"]  # object shown by the detection; O: none, or another one shows it
    detection: Int[Array, "O"]  # detection that shows the object; N: not visible
    visible: Bool[Array, "O"]
    allowed: Bool[Array, "O"]  # visible, and the sighting may become an episode
    place: Int[Array, "O"]  # position among the visible objects as decided; O: not visible


def gather_sightings(
    slot: Int[Array, "N"], order: Int[Array, "N"], allowed: Bool[Array, "N"], num_objects: int
) -> Sightings:
    """Finds the objects of a frame; of two detections of one object the later decided counts.

    `slot` is out of range for detections without object, `order` rises as they were decided.
    """
    num = slot.shape[0]
    shows = slot[:, None] == jnp.arange(num_objects)
    (last, at), first = reduce_together(
        ("top", jnp.where(shows, order[:, None], jnp.iinfo(jnp.int32).min)),
        ("min", jnp.where(shows, order[:, None], jnp.iinfo(jnp.int32).max)),
        axis=0,
    )
    visible = last > jnp.iinfo(jnp.int32).min
    detection = jnp.where(visible, at, num)
    chosen = shows & (detection == jnp.arange(num)[:, None])
    place = jnp.sum(first[:, None] < first, axis=0, dtype=jnp.int32)
    return Sightings(
        row=jnp.where(jnp.any(chosen, axis=1), slot, num_objects).astype(jnp.int32),
        detection=detection,
        visible=visible,
        allowed=jnp.any(chosen & allowed[:, None], axis=0),
        place=jnp.where(visible, place, num_objects),
    )


def empty_cooccurrence(num_objects: int, scalar: jnp.dtype) -> CooccurrenceGraph:
    """A graph without episodes."""
    row, square = (num_objects,), (num_objects, num_objects)
    return CooccurrenceGraph(
        episodes=zeros(row, np.int32),
        last_episode=full(row, NEVER, np.int32),
        context=zeros(square, bool),
        pending_context=zeros(square, bool),
        pending_hits=zeros(row, np.int32),
        count=zeros(square, np.int32),
        weight=zeros(square, scalar),
        edge_time=full(square, NEVER, np.int32),
        edge_order=zeros(square, np.int32),
    )


def update_cooccurrence(
    graph: CooccurrenceGraph,
    sightings: Sightings,
    ids: Int[Array, "O"],
    frame: Int[Array, ""],
    static: Static,
    t: Rules,
) -> tuple[CooccurrenceGraph, Bool[Array, "N"]]:
    """Lets objects in view decide on an episode (method.md#episodes, method.md#neighbor-order).

    Ids break ties (method.md#set-order). Also says which detections show an object that accepted an
    episode; its context is then every other visible object.
    """
    slots, row = graph.episodes.shape[0], sightings.row
    around = sightings.visible & ~jnp.eye(slots, dtype=bool)
    decided, accepted = _decide_episodes(graph, around, sightings.allowed & t.enabled, frame, t)
    order = _entry_order(decided, accepted[:, None] & around, sightings, ids)
    counted = _count_neighbors(decided, around, accepted, order, frame, t)
    updated = _trim(counted, sightings, static)
    return updated, (row < slots) & accepted[jnp.minimum(row, slots - 1)]


def _decide_episodes(
    graph: CooccurrenceGraph,
    around: Bool[Array, "O O"],
    allowed: Bool[Array, "O"],
    frame: Int[Array, ""],
    t: Rules,
) -> tuple[CooccurrenceGraph, Bool[Array, "O"]]:
    """Episodes of the allowed objects; a forced one keeps what is pending (method.md#episodes)."""
    first = graph.episodes == 0
    forced = (t.force_frames > 0) & ~first & (frame - graph.last_episode >= t.force_frames)
    common, union, again = reduce_together(
        ("sum", around & graph.context),
        ("sum", around | graph.context),
        ("all", around == graph.pending_context),
        axis=1,
    )
    common, union = common.astype(graph.weight.dtype), union.astype(graph.weight.dtype)
    overlap = jnp.where(union > 0, common / jnp.maximum(1.0, union), 1.0)

    open_ = allowed & ~forced & ~first
    same = open_ & (overlap >= t.same_context)
    other = open_ & ~same
    again = (graph.pending_hits > 0) & again
    hits = jnp.where(again, graph.pending_hits + 1, 1)
    settled = other & (hits >= t.debounce_frames)
    accepted = (allowed & (forced | first)) | settled
    graph = dataclasses.replace(
        graph,
        episodes=graph.episodes + accepted,
        last_episode=jnp.where(accepted, frame, graph.last_episode),
        context=jnp.where(accepted[:, None], around, graph.context),
        pending_context=jnp.where(other[:, None], around, graph.pending_context),
        pending_hits=jnp.where(same | settled, 0, jnp.where(other, hits, graph.pending_hits)),
    )
    return graph, accepted


def _entry_order(
    graph: CooccurrenceGraph,
    hit: Bool[Array, "O O"],
    sightings: Sightings,
    ids: Int[Array, "O"],
) -> Int[Array, "O O"]:
    """Order in which an episode makes its edges, that of a set (method.md#set-order)."""
    num, slots = sightings.row.shape[0], hit.shape[0]
    others = jnp.sum(sightings.visible, dtype=jnp.int32) - 1
    several = jnp.sum(hit & (graph.count == 0), axis=1) > 1
    largest_id = jnp.max(jnp.where(hit & several[:, None], ids, 0))
    by_id = jnp.broadcast_to(jnp.arange(slots, dtype=jnp.int32), hit.shape)

    def by_hash() -> Array:
        places = jnp.arange(num)
        at = sightings.place == places[:, None]
        is_listed, listed = largest(at)
        listed = jnp.where(is_listed, listed, slots)
        among = places[:-1] + (places[:-1] >= places[:, None])
        rank = jax.vmap(functools.partial(iteration_rank, copied=True), in_axes=(0, None))(
            ids.at[listed].get(mode="fill", fill_value=0)[among], others
        )
        own = sightings.place[:, None]
        place = sightings.place - (sightings.place > own)
        return rank[jnp.minimum(own, num - 1), jnp.clip(place, 0, num - 2)]

    if num < 2:
        return by_id
    return branch(largest_id >= copied_size(others), by_hash, lambda: by_id)


def _count_neighbors(
    graph: CooccurrenceGraph,
    around: Bool[Array, "O O"],
    accepted: Bool[Array, "O"],
    order: Int[Array, "O O"],
    frame: Int[Array, ""],
    t: Rules,
) -> CooccurrenceGraph:
    """Strengthens the edges to the neighbors of an episode (method.md#episodes)."""
    hit, known = accepted[:, None] & around, graph.count > 0
    weight = jnp.where(accepted[:, None], graph.weight * t.decay, graph.weight)
    newest = jnp.max(jnp.where(known, graph.edge_order, NEVER), axis=1, keepdims=True)
    return dataclasses.replace(
        graph,
        count=graph.count + hit,
        weight=jnp.where(hit, jnp.where(known, weight, 0.0) + 1.0, weight),
        edge_time=jnp.where(hit, frame, graph.edge_time),
        edge_order=jnp.where(hit & ~known, newest + 1 + order, graph.edge_order),
    )


def _trim(graph: CooccurrenceGraph, sightings: Sightings, static: Static) -> CooccurrenceGraph:
    """Keeps the first edges of the neighbor order, which becomes the order of the edges.

    Only objects in view can have got too many (method.md#neighbor-order).
    """
    slots, num, most = graph.count.shape[0], sightings.row.shape[0], static.switches.max_neighbours
    if not 0 < most < slots - 1:
        return graph
    full = sightings.visible & (jnp.sum(graph.count > 0, axis=1) > most)

    def trim() -> tuple[Array, Array]:
        seen = jax.tree.map(lambda leaf: leaf[jnp.minimum(sightings.row, slots - 1)], graph)
        rank = rank_neighbors(seen, static.switches.neighbour_trim)
        rank = rank[jnp.minimum(sightings.detection, num - 1)]
        dropped = full[:, None] & (rank >= most)
        order = jnp.where(full[:, None], rank, graph.edge_order)
        return jnp.where(dropped, 0, graph.count), order

    keep = lambda: (graph.count, graph.edge_order)  # noqa: E731
    count, order = branch(jnp.any(full), trim, keep, suits_all=True)
    return dataclasses.replace(graph, count=count, edge_order=order)


def rank_neighbors(graph: CooccurrenceGraph, by: Literal["weight", "recent"]) -> Int[Array, "R O"]:
    """Position of every neighbor, O where there is no edge (method.md#neighbor-order)."""
    known = graph.count > 0
    keys = {"weight": (-graph.weight, -graph.edge_time), "recent": (-graph.edge_time,)}
    rank = rank_rising([~known, *keys[by], graph.edge_order])
    return jnp.where(known, rank, known.shape[1])


def ranked_neighbors(
    rank: Int[Array, "R O"], most: int
) -> tuple[Int[Array, "R M"], Bool[Array, "R M"]]:
    """Slots of the first `most` neighbors of every object, and which of them are neighbors."""
    at = rank[:, None, :] == jnp.arange(most)[:, None]
    slot = jnp.sum(jnp.where(at, jnp.arange(rank.shape[1]), 0), axis=-1, dtype=jnp.int32)
    return slot, jnp.any(at, axis=-1)


def conditional(
    graph: CooccurrenceGraph, num_objects: Int[Array, ""], t: Rules
) -> Float[Array, "O O"]:
    """Smoothed P[i, j] of seeing j in an episode of i (method.md#conditional-probability).

    Pairs never seen together have a share, too, and so has an object with itself. Objects count in
    every lifecycle state.
    """
    scalar = graph.weight.dtype
    total = graph.episodes.astype(scalar) + t.smoothing * jnp.maximum(1, num_objects).astype(scalar)
    share = divide(graph.count.astype(scalar) + t.smoothing, jnp.maximum(total, _TINY)[:, None])
    return jnp.where(total[:, None] > _TINY, jnp.clip(share, 0.0, 1.0), 0.0)


def reorder_cooccurrence(
    graph: CooccurrenceGraph, order: Int[Array, "O"], alive: Bool[Array, "O"]
) -> CooccurrenceGraph:
    """Moves objects from the slots in `order`; what is gone is forgotten, by others, too."""
    empty = empty_cooccurrence(order.shape[0], graph.weight.dtype)

    def move(leaf: Array, blank: Array) -> Array:
        if leaf.ndim == 1:
            return jnp.where(alive, leaf[order], blank)
        return jnp.where(alive[:, None] & alive, leaf[order][:, order], blank)

    return jax.tree.map(move, graph, empty)
