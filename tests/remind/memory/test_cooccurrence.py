import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.remind.memory.cooccurrence import (
    empty_cooccurrence,
    gather_sightings,
    rank_neighbors,
    ranked_neighbors,
    reorder_cooccurrence,
    update_cooccurrence,
)
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.relations import Cooccurrence
from tests.statics import make_static


@jax.jit
def _sightings(slot, order, allowed, like):
    return gather_sightings(slot, order, allowed, like.shape[0])


_update = jax.jit(update_cooccurrence, static_argnames="static")


@jax.jit
def _order(graph):
    """The 20 strongest neighbors."""
    return ranked_neighbors(rank_neighbors(graph, "weight"), 20)


def show(graph, frame, visible, *, slots=8, rules=None, allowed=None):
    """Shows a frame with the given objects, one detection each; ids are the slots."""
    slot = np.full(slots, graph.episodes.shape[0], np.int32)
    slot[: len(visible)] = visible
    allowed = np.ones(slots, bool) if allowed is None else np.isin(slot, allowed)
    sightings = _sightings(slot, np.arange(slots), allowed, graph.episodes)
    ids = np.arange(graph.episodes.shape[0])
    rules = Thresholds(cooccurrence=rules or Cooccurrence()).as_arrays().cooccurrence
    return _update(graph, sightings, ids, jnp.int32(frame), make_static(), rules)[0]


def edges(graph, owner=0):
    return {int(j): int(graph.count[owner, j]) for j in np.flatnonzero(graph.count[owner])}


def test_full_list_keeps_the_lowest_ids_of_equal_edges():
    graph = show(empty_cooccurrence(26, jnp.float32), 0, range(26), slots=26)
    assert edges(graph) == {j: 1 for j in range(1, 21)}
    slot, valid = _order(graph)
    assert list(np.asarray(slot[0])[valid[0]]) == list(range(1, 21))


def test_later_decided_detection_shows_the_object():
    slot, order = jnp.array([2, 0, 2, 5]), jnp.array([7, 1, 3, 9])
    seen = _sightings(slot, order, jnp.array([True, False, False, True]), jnp.zeros(4))
    np.testing.assert_array_equal(seen.row, [2, 0, 4, 4])
    np.testing.assert_array_equal(seen.detection, [1, 4, 0, 4])
    np.testing.assert_array_equal(seen.visible, [True, False, True, False])
    np.testing.assert_array_equal(seen.allowed, [False, False, True, False])


def test_object_without_leave_makes_no_episode():
    graph = show(empty_cooccurrence(4, jnp.float32), 0, [0, 1, 2], allowed=[0, 1])
    np.testing.assert_array_equal(graph.episodes, [1, 1, 0, 0])
    assert edges(graph) == {1: 1, 2: 1}
    switched_off = show(
        empty_cooccurrence(4, jnp.float32), 0, [0, 1, 2], rules=Cooccurrence(enabled=False)
    )
    assert not switched_off.episodes.any()


def test_forgotten_object_leaves_no_trace():
    graph = empty_cooccurrence(6, jnp.float32)
    for frame, visible in enumerate([[0, 1, 2, 3], [0, 3], [1, 2, 3], [0, 1, 3]]):
        graph = show(graph, frame, visible)
    moved = jax.jit(reorder_cooccurrence)(
        graph, jnp.array([0, 2, 3, 1, 4, 5]), jnp.array([True, True, True, False, False, False])
    )
    assert edges(moved) == {1: 1, 2: 2}  # what were 2 and 3
    assert edges(moved, 2) == {0: 2, 1: 1}
    np.testing.assert_array_equal(moved.episodes[:4], [*np.asarray(graph.episodes)[[0, 2, 3]], 0])
    assert not moved.count[3:].any()
    assert not moved.context[:, 3:].any()
