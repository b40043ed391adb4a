from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.masks.relations import find_row_ends, relate_masks
from remind_jax.observation import MaskRelations, Masks
from remind_jax.remind.memory.cooccurrence import (
    empty_cooccurrence,
    gather_sightings,
    update_cooccurrence,
)
from remind_jax.remind.memory.distances import (
    DistanceGraph,
    empty_distances,
    reorder_distances,
    update_distances,
)
from remind_jax.remind.perception.relations import Contact, observe_relations
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.relations import Cooccurrence
from remind_jax.remind.thresholds.relations import Relations as Rules
from tests.remind.disambiguation.scenes import relations_of
from tests.statics import make_static, only

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "graphs" / "layout_graph_alt.npz"


@jax.jit
def _update(graph, relations, slot, order, allowed, accepted, rules):
    sightings = gather_sightings(slot, order, allowed, graph.nearer.shape[0])
    return update_distances(graph, relations, sightings, accepted, rules)


def update(graph, relations, slot, accepted, *, allowed=None, enabled=True):
    num = len(slot)
    allowed = np.ones(num, bool) if allowed is None else np.array(allowed)
    slot, order = np.array(slot, np.int32), np.arange(num)
    rules = Thresholds(relations=Rules(enabled=enabled)).as_arrays().relations
    return _update(graph, relations, slot, order, allowed, np.array(accepted), rules)


def symmetric(*pairs, num=3):
    matrix = np.zeros((num, num))
    for i, j, value in pairs:
        matrix[i, j] = matrix[j, i] = value
    return matrix


def read_order(graph: DistanceGraph, owner: Any, first: Any, second: Any) -> tuple[Any, ...]:
    """What an object remembers of the distances to two others (method.md#distance-evidence).

    Episodes with both, share of them in which the first was nearer, mean and sample deviation of
    the margin; slots broadcast together.
    """
    nearer, margin = np.asarray(graph.nearer), np.asarray(graph.margin)
    low, high = np.minimum(first, second), np.maximum(first, second)
    won = nearer[owner, first, second]
    count = won + nearer[owner, second, first]
    spread = margin[owner, high, low] / np.maximum(1, count - 1)
    deviation = np.where(count > 1, np.sqrt(np.maximum(0, spread)), 0)
    return count, won / np.maximum(1, count), margin[owner, low, high], deviation


def test_chairs_and_lamp_of_the_page(x64):
    """method.md#example-lamp, from masks to the edges after seven frames."""
    rules = Thresholds().as_arrays(jnp.float64)
    neighbors, graph = empty_cooccurrence(4, jnp.float64), empty_distances(4, jnp.float64)

    @jax.jit
    def step(neighbors, graph, masks, frame):
        slot = jnp.arange(3, dtype=jnp.int32)
        seen = gather_sightings(slot, slot, jnp.ones(3, bool), 4)
        neighbors, accepted = update_cooccurrence(
            neighbors,
            seen,
            jnp.arange(4, dtype=jnp.int32),
            frame,
            make_static(precision="float64"),
            rules.cooccurrence,
        )
        relations = observe_relations(masks, rules.relations)
        return neighbors, update_distances(graph, relations, seen, accepted, rules.relations)

    for frame, shift in enumerate([0, 4, -4, 8, 0, 2, -6]):
        pixels = np.zeros((3, 200, 300), bool)
        box = np.array([(x, 100, x + 40, 140) for x in (20, 100, 180 + shift)], float)
        for mask, (left, _, right, _) in zip(pixels, box.astype(int), strict=True):
            mask[100:140, left:right] = True
        area = np.full(3, 1600.0)
        ends = [find_row_ends(mask) for mask in pixels]
        relations = relate_masks(pixels, box, area, ends, num_slots=3)
        center, valid = (box[:, :2] + box[:, 2:] - 1) / 2, np.ones(3, bool)
        masks = only(Masks, box=box, center=center, area=area, relations=relations, valid=valid)
        neighbors, graph = step(neighbors, graph, masks, jnp.int32(frame))

    edges = graph.edges
    np.testing.assert_array_equal(neighbors.episodes, [3, 3, 3, 0])
    np.testing.assert_array_equal(edges.count[:2, 2], [3, 3])
    # printed with six decimals; the gaps come from float32 distance transforms
    np.testing.assert_allclose(edges.gap_mean[:2, 2], [3.033333, 1.010708], atol=2e-6)
    np.testing.assert_allclose(read_order(graph, 2, 0, 1), [3, 0, 2.022625, 0.002598], atol=2e-6)


def test_of_equal_distances_the_larger_id_is_nearer():
    equal = relations_of(symmetric((0, 1, 0.5), (0, 2, 0.5)))
    graph = update(empty_distances(3, jnp.float32), equal, [0, 1, 2], [True] * 3)
    assert (graph.nearer[0, 1, 2], graph.nearer[0, 2, 1]) == (0, 1)


@pytest.mark.parametrize(
    ("allowed", "pending"),
    [
        ([True, True, True], [[0, 1, 1], [1, 0, 1], [1, 1, 0]]),
        ([True, True, False], [[0, 1, 0], [1, 0, 0], [1, 1, 0]]),  # 2 is left out, but looks on
        ([True, False, False], [[0, 1, 1], [1, 0, 1], [1, 1, 0]]),  # one alone sees all
    ],
)
def test_who_collects_whom(allowed, pending):
    graph = update(
        empty_distances(3, jnp.float32), relations_of(np.ones((3, 3))), [0, 1, 2], [False] * 3,
        allowed=allowed,
    )  # fmt: skip
    np.testing.assert_array_equal(graph.pending.count, pending)


def test_switched_off():
    graph = update(
        empty_distances(3, jnp.float32), relations_of(np.ones((3, 3))), [0, 1, 2], [True] * 3,
        enabled=False,
    )  # fmt: skip
    assert not any(leaf.any() for leaf in jax.tree.leaves(graph))


def test_newest_relations_stay_when_there_are_too_many():
    graph = empty_distances(2, jnp.float32)
    for gap in [100.0, 1.0, 2.0, 4.0]:
        graph = update(graph, relations_of(symmetric((0, 1, gap), num=2)), [0, 1], [False, False])
    graph = update(graph, relations_of(symmetric((0, 1, 8.0), num=2)), [0, 1], [True, True])
    assert graph.edges.gap_mean[0, 1] == 4.0


def test_forgotten_object_leaves_no_trace():
    rng = np.random.default_rng(0)
    graph = empty_distances(6, jnp.float32)
    for _ in range(4):
        gaps = rng.random((4, 4))
        graph = update(graph, relations_of(gaps + gaps.T), [0, 1, 2, 3], rng.random(4) < 0.7)
    move = jax.jit(reorder_distances)
    moved = move(graph, jnp.array([0, 2, 3, 1, 4, 5]), jnp.arange(6) < 3)
    left = np.array([0, 2, 3])

    def check(ours, before):
        axes = 3 if ours.shape == (6, 6, 6) else 2
        before = np.asarray(before)[np.ix_(*[left] * axes)]
        np.testing.assert_array_equal(ours[(slice(3),) * axes], before)
        assert np.count_nonzero(ours) == np.count_nonzero(before)

    jax.tree.map(check, moved, graph)
    last_gone = move(graph, jnp.arange(6), jnp.arange(6) < 3)
    assert not last_gone.edges.count[:, 3].any()
    assert not last_gone.nearer[:, 3].any()
    jax.tree.map(
        np.testing.assert_array_equal, move(graph, jnp.arange(6), jnp.arange(6) < 4), graph
    )


def test_graphs_of_the_original(x64):
    """One run of the original: sequence layout, variant graph_alt, 120 frames (golden README).

    Its decisions and the geometry of its detections go in; its graphs come out.
    """
    data = dict(np.load(GOLDEN))
    ids, num = data["object_ids"], data["object"].shape[1]
    slots, scalar = len(ids) + 1, jnp.float64
    static = make_static(precision="float64", max_neighbours=6, neighbour_trim="recent")
    rules = Thresholds(cooccurrence=Cooccurrence(decay=0.9)).as_arrays(scalar)

    def step(graphs, frame):
        neighbors, graph = graphs
        at, found, box, center, area, relations = frame
        masks = only(Masks, box=box, center=center, area=area, relations=relations, valid=area > 0)
        seen = gather_sightings(found, jnp.arange(num), jnp.ones(num, bool), slots)
        neighbors, accepted = update_cooccurrence(
            neighbors, seen, jnp.arange(slots, dtype=jnp.int32), at, static, rules.cooccurrence
        )
        relations = observe_relations(masks, rules.relations)
        graph = update_distances(graph, relations, seen, accepted, rules.relations)
        degrees = [jnp.sum(count > 0, axis=1) for count in (neighbors.count, graph.edges.count)]
        return (neighbors, graph), (degrees[0], neighbors.episodes, degrees[1])

    found = np.where(data["object"] >= 0, np.searchsorted(ids, data["object"]), slots)
    gap_px = data["gap_px"] + np.swapaxes(data["gap_px"], 1, 2)
    relations = MaskRelations(gap_px.astype(float), data["exact"], data["touches_border"])
    frame = np.arange(len(found), dtype=np.int32)
    geometry = [data[name].astype(float) for name in ("box", "center", "area")]
    graphs = empty_cooccurrence(slots, scalar), empty_distances(slots, scalar)
    scan = jax.jit(lambda graphs, frames: jax.lax.scan(step, graphs, frames))
    (neighbors, graph), history = scan(
        graphs, (frame, found.astype(np.int32), *geometry, relations)
    )

    rows = data["row_frame"], np.searchsorted(ids, data["row_object"])
    for name, ours in zip(("degree", "episodes", "distance_degree"), history, strict=True):
        np.testing.assert_array_equal(np.asarray(ours)[rows], data[f"row_{name}"], name)

    def slots_of(table, *names):
        return tuple(np.searchsorted(ids, data[f"{table}_{name}"]) for name in names)

    edge = slots_of("edge", "src", "dst")
    assert np.count_nonzero(neighbors.count) == len(edge[0])
    np.testing.assert_array_equal(np.asarray(neighbors.count)[edge], data["edge_count"])
    np.testing.assert_array_equal(np.asarray(neighbors.edge_time)[edge], data["edge_last_seen"])
    close = {"rtol": 0, "atol": 2e-6}  # recorded as float32; gaps are float32, too
    np.testing.assert_allclose(np.asarray(neighbors.weight)[edge], data["edge_weight"], **close)
    edge, edges = slots_of("dist", "src", "dst"), jax.tree.map(np.asarray, graph.edges)
    np.testing.assert_array_equal(edges.gap_count[edge], data["dist_n_gap"])
    for contact in Contact:
        ours = edges.contact_count[edge][:, contact]
        np.testing.assert_array_equal(ours, data[f"dist_{contact.name.lower()}"])
    for name in ("gap", "center", "support"):
        ours = getattr(edges, f"{name}_mean")[edge]
        np.testing.assert_allclose(ours, data[f"dist_{name}"], **close)
    count, share, margin, _ = read_order(graph, *slots_of("pair", "src", "first", "second"))
    np.testing.assert_array_equal(count, data["pair_count"])
    np.testing.assert_array_equal(np.round(share * count), data["pair_first_before"])
    np.testing.assert_allclose(margin, data["pair_margin"], **close)
