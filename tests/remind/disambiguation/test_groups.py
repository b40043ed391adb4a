import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.remind.disambiguation.groups import form_groups, measure_affinity
from tests.statics import make_static

from .scenes import relations_of, thresholds, undecided

NUM_OBJECTS = 6
_form = jax.jit(form_groups, static_argnames="static")
_measure = jax.jit(measure_affinity)


def edge_table(*edges, num=NUM_OBJECTS):
    """A table with edges (from, to, reliability, gap)."""
    table = np.zeros((num, num, 4), np.float32)
    for source, target, reliability, gap in edges:
        table[source, target] = reliability, 1.0, gap, 0.0
    return table


def form(present, candidates, class_id, *, exists=None, table=None, distance=None):
    num = len(present)
    distance = np.full((num, num), 9.0) if distance is None else distance
    return jax.device_get(
        _form(
            undecided(present, candidates),
            np.array(class_id),
            np.ones(NUM_OBJECTS, bool) if exists is None else exists,
            relations_of(distance.astype(np.float32)),
            edge_table() if table is None else table,
            np.zeros((NUM_OBJECTS, NUM_OBJECTS, 4), np.int32),
            make_static(),
            thresholds("float32"),
        )
    )


def test_two_closed_groups_that_stand_as_remembered_are_one():
    table = edge_table((1, 2, 1.0, 0.5), (2, 1, 1.0, 0.5))
    present, candidates = [True] * 4, [[0, 1, -1], [1, 0, -1], [2, 3, -1], [3, 2, -1]]
    distance = np.full((4, 4), 1.5)
    distance[1, 2] = distance[2, 1] = 0.5
    near = form(present, candidates, [0] * 4, table=table, distance=distance)
    np.testing.assert_array_equal(near.root, [0, 0, 0, 0])
    assert near.closed[0]
    np.testing.assert_array_equal(near.num_candidates, [4, 0, 0, 0])
    apart = form(present, candidates, [0] * 4, table=table)
    np.testing.assert_array_equal(apart.root, [0, 0, 2, 2])
    other_class = form(present, candidates, [0, 0, 1, 1], table=table, distance=distance)
    np.testing.assert_array_equal(other_class.root, [0, 0, 2, 2])


def test_repeated_and_missing_candidates():
    groups = form([True] * 3, [[0, 0, -1], [0, 1, 0], [1, 0, -1]], [0] * 3)
    np.testing.assert_array_equal(groups.root, [-1, 1, 1])
    np.testing.assert_array_equal(groups.num_candidates, [0, 2, 0])
    assert groups.closed[1]
    exists = np.ones(NUM_OBJECTS, bool)
    exists[1] = False
    gone = form([True] * 3, [[0, 0, -1], [0, 1, 0], [1, 0, -1]], [0] * 3, exists=exists)
    assert gone.fits[1]
    assert not gone.closed[1]


@pytest.mark.parametrize(
    ("change", "factor"),
    [
        ({}, 1.0),
        ({"gap_quality": 0.0}, 0.65),
        ({"truncated": True}, 0.5),
        # support 0.5: informative 1 - 0.4, agreement 0.5 + 0.25 * 0.5 instead of 0.75
        ({"support": 0.5}, 0.6 * 0.625 / 0.75),
        # touching in 4 of 4 episodes: agreement 1 instead of 0.75
        ({"contact": 3}, 1.0 / 0.75),
    ],
)
def test_affinity_weighs_what_was_seen(change, factor):
    """method.md#undecided-groups, one edge in one direction: half its similarity times weight."""
    relations = relations_of(np.full((2, 2), 0.6, np.float32))
    for name, value in change.items():
        old = getattr(relations, name)
        relations = dataclasses.replace(relations, **{name: np.full_like(old, value)})
    contact = np.zeros((NUM_OBJECTS, NUM_OBJECTS, 4), np.int32)
    contact[0, 1, 3] = 4
    affinity = _measure(
        np.array([[0], [1]]),
        np.ones((2, 1), bool),
        relations,
        edge_table((0, 1, 0.5, 0.5)),
        contact,
        thresholds("float32"),
    )
    expected = 0.5 * np.exp(-0.1 / 0.2) * 0.5 * 0.75 * factor
    # float32 exponential of a difference of two rounded distances
    np.testing.assert_allclose(affinity[0, 1], expected, rtol=1e-6)
    np.testing.assert_allclose(affinity[1, 0], expected, rtol=1e-6)
