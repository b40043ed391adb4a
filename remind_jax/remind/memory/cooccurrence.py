"""Who is seen with whom: every object counts the others around it (paper III-D).

Rule: method.md#episodes.

Objects count episodes, not frames: an episode is a sighting in new surroundings, or after some
time in the same ones. Letters: `N` detections, `O` object slots;
the first object axis is the one that remembers, the second the one remembered.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Num

from remind_jax.numerics.absent import NEVER
from remind_jax.numerics.constant_arrays import full, zeros
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.rounding import divide
from remind_jax.numerics.set_order import copied_size, iteration_rank
from remind_jax.remind.memory.writing import write_rows
from remind_jax.remind.thresholds.relations import Cooccurrence as Rules
from remind_jax.static import Static

_TINY = 1e-12


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
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


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
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

    Args:
      slot: Object slot of every matched or created detection, out of range for others.
      order: Rises in the order in which the detections were decided.
      allowed: Detections that may make an episode (method.md#episodes).
      num_objects: Object slots.
    """
    num = slot.shape[0]
    shows = slot[:, None] == jnp.arange(num_objects)
    rank = jnp.where(shows, order[:, None], jnp.iinfo(jnp.int32).min)
    visible = jnp.any(shows, axis=0)
    detection = jnp.where(visible, jnp.argmax(rank, axis=0), num).astype(jnp.int32)
    chosen = shows & (detection == jnp.arange(num)[:, None])
    first = jnp.min(jnp.where(shows, order[:, None], jnp.iinfo(jnp.int32).max), axis=0)
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
    """Lets every visible object decide whether this frame is an episode.

    Rules: method.md#episodes, method.md#neighbor-order.

    Args:
      graph: Graph before the frame.
      sightings: Objects of the frame.
      ids: Ids of the objects, which break ties (method.md#set-order).
      frame: Number of the frame.
      static: How many neighbors are kept.
      t: Thresholds.

    Returns:
      The graph, and which detections show an object that accepted an episode. Its context is
      then every other visible object.
    """
    slots = graph.episodes.shape[0]
    row = sightings.row
    own = row[:, None] == jnp.arange(slots)
    around = sightings.visible & ~own
    allowed = jnp.any(own & sightings.allowed, axis=1) & t.enabled
    old = jax.tree.map(lambda leaf: leaf[jnp.minimum(row, slots - 1)], graph)
    decided, accepted = _decide_episodes(old, around, allowed, frame, t)
    order = _entry_order(decided, accepted[:, None] & around, sightings, ids)
    updated = _count_neighbors(decided, around, accepted, order, frame, static, t)
    return write_rows(graph, row, updated), accepted


def _decide_episodes(
    rows: CooccurrenceGraph,
    around: Bool[Array, "N O"],
    allowed: Bool[Array, "N"],
    frame: Int[Array, ""],
    t: Rules,
) -> tuple[CooccurrenceGraph, Bool[Array, "N"]]:
    """Episode logic of the visible objects; a forced episode keeps what is pending.

    Rule: method.md#episodes.
    """
    first = rows.episodes == 0
    forced = (t.force_frames > 0) & ~first & (frame - rows.last_episode >= t.force_frames)
    common = jnp.sum(around & rows.context, axis=1, dtype=rows.weight.dtype)
    union = jnp.sum(around | rows.context, axis=1, dtype=rows.weight.dtype)
    overlap = jnp.where(union > 0, common / jnp.maximum(1.0, union), 1.0)

    open_ = allowed & ~forced & ~first
    same = open_ & (overlap >= t.same_context)
    other = open_ & ~same
    again = (rows.pending_hits > 0) & jnp.all(around == rows.pending_context, axis=1)
    hits = jnp.where(again, rows.pending_hits + 1, 1)
    settled = other & (hits >= t.debounce_frames)
    accepted = (allowed & (forced | first)) | settled
    rows = dataclasses.replace(
        rows,
        episodes=rows.episodes + accepted,
        last_episode=jnp.where(accepted, frame, rows.last_episode),
        context=jnp.where(accepted[:, None], around, rows.context),
        pending_context=jnp.where(other[:, None], around, rows.pending_context),
        pending_hits=jnp.where(same | settled, 0, jnp.where(other, hits, rows.pending_hits)),
    )
    return rows, accepted


def _entry_order(
    rows: CooccurrenceGraph,
    hit: Bool[Array, "N O"],
    sightings: Sightings,
    ids: Int[Array, "O"],
) -> Int[Array, "N O"]:
    """Rises in the order in which the edges of an episode are made, that of a set.

    Rule: method.md#set-order.
    """
    num, slots = hit.shape
    others = jnp.sum(sightings.visible, dtype=jnp.int32) - 1
    several = jnp.sum(hit & (rows.count == 0), axis=1) > 1
    largest = jnp.max(jnp.where(hit & several[:, None], ids, 0))
    by_id = jnp.broadcast_to(jnp.arange(slots, dtype=jnp.int32), hit.shape)

    def by_hash() -> Array:
        at = sightings.place == jnp.arange(num)[:, None]
        listed = jnp.where(jnp.any(at, axis=1), jnp.argmax(at, axis=1), slots)
        own = sightings.place[jnp.minimum(sightings.row, slots - 1)][:, None]
        among = jnp.arange(num - 1) + (jnp.arange(num - 1) >= own)
        rank = jax.vmap(functools.partial(iteration_rank, copied=True), in_axes=(0, None))(
            ids.at[listed].get(mode="fill", fill_value=0)[among], others
        )
        place = sightings.place - (sightings.place > own)
        return jnp.take_along_axis(rank, jnp.clip(place, 0, num - 2), axis=1)

    if num < 2:
        return by_id
    return branch(largest >= copied_size(others), by_hash, lambda: by_id)


def _count_neighbors(
    rows: CooccurrenceGraph,
    around: Bool[Array, "N O"],
    accepted: Bool[Array, "N"],
    order: Int[Array, "N O"],
    frame: Int[Array, ""],
    static: Static,
    t: Rules,
) -> CooccurrenceGraph:
    """Strengthens the edges to the neighbors of an episode.

    Rules: method.md#episodes, method.md#neighbor-order.
    """
    slots = rows.count.shape[1]
    hit, known = accepted[:, None] & around, rows.count > 0
    weight = jnp.where(accepted[:, None], rows.weight * t.decay, rows.weight)
    newest = jnp.max(jnp.where(known, rows.edge_order, NEVER), axis=1, keepdims=True)
    rows = dataclasses.replace(
        rows,
        count=rows.count + hit,
        weight=jnp.where(hit, jnp.where(known, weight, 0.0) + 1.0, weight),
        edge_time=jnp.where(hit, frame, rows.edge_time),
        edge_order=jnp.where(hit & ~known, newest + 1 + order, rows.edge_order),
    )
    most = static.max_neighbours
    if not 0 < most < slots - 1:
        return rows
    full = jnp.sum(rows.count > 0, axis=1, keepdims=True) > most
    return branch(jnp.any(full), lambda: _trim(rows, full, static), lambda: rows)


def _trim(rows: CooccurrenceGraph, full: Bool[Array, "N 1"], static: Static) -> CooccurrenceGraph:
    """Keeps the first edges of the neighbor order, which becomes the order of the edges."""
    rank = rank_edges(rows, static)
    dropped = full & (rank >= static.max_neighbours)
    return dataclasses.replace(
        rows,
        count=jnp.where(dropped, 0, rows.count),
        edge_order=jnp.where(full, rank, rows.edge_order),
    )


def rank_edges(graph: CooccurrenceGraph, static: Static) -> Int[Array, "R O"]:
    """Position of every neighbor by the rule that trims the lists (method.md#neighbor-order)."""
    keys = {"weight": (graph.weight, graph.edge_time), "recent": (graph.edge_time,)}
    return neighbor_rank(graph.count > 0, keys[static.neighbour_trim], graph.edge_order)


def neighbor_rank(
    known: Bool[Array, "R O"],
    falling: Sequence[Num[Array, "R O"]],
    order: Int[Array, "R O"],
) -> Int[Array, "R O"]:
    """Position of every neighbor, the strongest first; O where there is no edge.

    Rule: method.md#neighbor-order.

    Counting the edges before each edge is quicker than sorting the rows.

    Args:
      known: Edges.
      falling: Sort keys, the first decides first; the larger comes first.
      order: Last sort key; the smaller comes first.
    """

    def pairs(leaf: Array) -> tuple[Array, Array]:
        return leaf[:, :, None], leaf[:, None, :]

    earlier, tie = False, True
    for key in falling:
        one, other = pairs(key)
        earlier, tie = earlier | (tie & (one > other)), tie & (one == other)
    one, other = pairs(order)
    before = known[:, :, None] & (earlier | (tie & (one < other)))
    return jnp.where(known, jnp.sum(before, axis=1, dtype=jnp.int32), known.shape[1])


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
    """Smoothed probability P[i, j] of seeing j in an episode of i, [0, 1].

    Rule: method.md#conditional-probability.

    Pairs never seen together have a share, too, and so has an object with itself.

    Args:
      graph: Counts.
      num_objects: Objects in memory, in every lifecycle state.
      t: Smoothing.
    """
    scalar = graph.weight.dtype
    total = graph.episodes.astype(scalar) + t.smoothing * jnp.maximum(1, num_objects).astype(scalar)
    share = divide(graph.count.astype(scalar) + t.smoothing, jnp.maximum(total, _TINY)[:, None])
    return jnp.where(total[:, None] > _TINY, jnp.clip(share, 0.0, 1.0), 0.0)


def reorder_cooccurrence(
    graph: CooccurrenceGraph, order: Int[Array, "O"], alive: Bool[Array, "O"]
) -> CooccurrenceGraph:
    """Moves objects to other slots and forgets those that are gone, by others, too.

    Args:
      graph: Graph by old slots.
      order: Old slot of every new one.
      alive: New slots in use.
    """
    empty = empty_cooccurrence(order.shape[0], graph.weight.dtype)

    def move(leaf: Array, blank: Array) -> Array:
        if leaf.ndim == 1:
            return jnp.where(alive, leaf[order], blank)
        return jnp.where(alive[:, None] & alive, leaf[order][:, order], blank)

    return jax.tree.map(move, graph, empty)
