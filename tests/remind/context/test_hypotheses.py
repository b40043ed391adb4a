"""What is left of the beam in the end (method.md#kept-hypotheses)."""

import dataclasses
import functools

import chex
import jax
import numpy as np
import pytest

from remind_jax.remind.context.hypotheses import find_hypotheses, no_hypotheses
from tests.statics import make_static

from .scenes import read_view, thresholds
from .test_beam import NUM, SLOTS, list_rows, small_example, two_alike, walk

pytestmark = pytest.mark.usefixtures("x64")
STATIC = make_static(precision="float64", beam_width=10, num_hypotheses=5)


@functools.partial(jax.jit, static_argnames="static")
def _find(scene, t, static):
    return find_hypotheses(read_view(scene, t, static), static, t.sets)


def find(scene, **changed):
    """Objects, detections and score of every hypothesis."""
    found = jax.device_get(_find(scene, thresholds(sets=changed), static=STATIC))
    assert not np.any(found.members[~found.valid])
    assert not np.any(found.detections[~found.valid])
    np.testing.assert_array_equal(found.size, found.members.sum(1))
    return [
        (
            set(np.flatnonzero(found.members[row]).tolist()),
            set(np.flatnonzero(found.detections[row]).tolist()),
            float(found.score[row]),
        )
        for row in np.flatnonzero(found.valid)
    ]


@pytest.mark.parametrize("make", [small_example, two_alike])
def test_best_rows_of_the_beam_are_kept(make):
    """Stably by score; single objects explain too little of a frame with several detections."""
    rows = [row for row in list_rows(walk(make())[-1]) if len(row[0]) >= 2]
    rows.sort(key=lambda row: -row[2])
    assert find(make()) == rows[: STATIC.switches.num_hypotheses]


def test_least_score():
    assert [row[2] > 0 for row in find(small_example())] == [True] * 4 + [False]
    assert len(find(small_example(), min_set_score=0.409)) == 2


def test_one_detection_may_be_explained_by_one_object_or_none():
    scene = small_example(det_class=np.array([-1, 2, -1], np.int32))
    found = find(scene)
    assert [(objects, dets) for objects, dets, _ in found] == [({3}, {1}), (set(), set())]
    assert found[0][2] > found[1][2] == 0


def test_nothing_to_search():
    nothing = jax.device_get(no_hypotheses(NUM, SLOTS, STATIC))
    for scene in (
        small_example(det_class=np.full(NUM, -1, np.int32)),
        small_example(det_class=np.full(NUM, 8, np.int32)),
        small_example(object_class=np.full(SLOTS, -1, np.int32)),
    ):
        found = jax.device_get(_find(scene, thresholds(), static=STATIC))
        chex.assert_trees_all_equal(found, nothing)


def test_fewer_slots_than_detections_of_a_class():
    """Detections beyond the slots still say that the class has more of them than objects."""
    stored = np.arange(SLOTS) < 2
    scene = small_example()
    scene = dataclasses.replace(
        scene,
        count=np.where(stored[:, None] & stored, scene.count, 0),
        episodes=np.where(stored, scene.episodes, 0),
        anchors=scene.anchors & stored,
        object_class=np.where(stored, 0, -1).astype(np.int32),
        det_class=np.zeros(NUM, np.int32),
    )
    slots = ("count", "edge_time", "edge_order", "episodes", "object_class", "anchors")
    tight = {name: getattr(scene, name)[:2] for name in slots}
    tight |= {name: tight[name][:, :2] for name in slots[:3]}
    few = dataclasses.replace(scene, **tight, score=scene.score[:, :2])
    found = find(scene)
    assert len(found) > 1
    assert find(few) == found
