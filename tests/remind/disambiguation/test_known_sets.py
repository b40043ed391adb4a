import dataclasses

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.errors import ConfigError
from remind_jax.remind.disambiguation.joint_assignments import NUMBERS, GroupStatus, list_injections
from remind_jax.remind.stages import MatchOrigin
from tests.golden.load import load_expected
from tests.statics import change_parts, change_static

from .scenes import (
    GOLDEN,
    NUM_OBJECTS,
    STATIC,
    Scene,
    graph_of,
    load_scenes,
    settle_scenes,
    undecided,
)

pytestmark = pytest.mark.usefixtures("x64")
ROUNDING = 1e-12  # float64 sums of a hundred terms below 30 in another order


def number(groups, name):
    return groups.numbers[..., NUMBERS.index(name)]


def expected(name):
    return load_expected(GOLDEN)[name]


def test_frozen_scenes_are_settled_as_by_the_plain_rules():
    settled = settle_scenes(load_scenes())
    np.testing.assert_array_equal(settled.resolved_slot, expected("resolved_slot"))
    np.testing.assert_array_equal(settled.remaining, expected("remaining"))
    sources = np.array([MatchOrigin.NONE, MatchOrigin.DISTANCE_FULL, MatchOrigin.DISTANCE_PARTIAL])
    np.testing.assert_array_equal(settled.source, sources[expected("full")])
    np.testing.assert_array_equal(settled.root, expected("root"))
    np.testing.assert_array_equal(settled.groups.status, expected("status"))
    np.testing.assert_array_equal(settled.groups.num_detections, expected("n_det"))
    rated = settled.groups.status > GroupStatus.NO_ASSIGNMENT
    anchors = np.where(rated, settled.groups.num_anchors, 0)
    np.testing.assert_array_equal(anchors, expected("n_anchor"))
    numbers = [number(settled.groups, name) for name in NUMBERS if name != "second"]
    np.testing.assert_allclose(np.stack(numbers, -1), expected("numbers"), atol=ROUNDING)
    np.testing.assert_allclose(settled.resolved_score, expected("resolved_score"), atol=ROUNDING)


def test_capacities_and_padding_do_not_matter():
    scenes, more, dets = load_scenes(), 5, 3
    noise = np.random.default_rng(0)

    def widen(value, *growing):
        """Adds slots to the named axes and fills them with anything."""
        value = np.asarray(value)
        pad = [(0, 0)] * value.ndim
        for axis, count in growing:
            pad[axis] = (0, count)
        wide = np.pad(value, pad)
        old = np.pad(np.ones(value.shape, bool), pad)
        return np.where(old, wide, noise.integers(0, 2, wide.shape).astype(value.dtype))

    entries, graph = scenes.undecided, scenes.graph
    candidates = widen(entries.slot, (1, dets))
    virtual = candidates >= NUM_OBJECTS
    cube = [(axis, more) for axis in (1, 2, 3)]
    never = lambda value, axis, count: np.pad(  # noqa: E731
        value, [(0, count if i == axis else 0) for i in range(value.ndim)]
    )
    wide = Scene(
        undecided(
            never(entries.present, 1, dets), np.where(virtual, candidates + more, candidates)
        ),
        widen(scenes.class_id, (1, dets)),
        np.pad(scenes.matched_slot, ((0, 0), (0, dets)), constant_values=-1),
        widen(scenes.matched_pass, (1, dets)),
        never(widen(scenes.candidate, (2, more)), 1, dets),
        jax.tree.map(lambda value: widen(value, (1, dets), (2, more)), scenes.pairs),
        never(scenes.object_exists, 1, more),
        jax.tree.map(lambda value: widen(value, (1, dets), (2, dets)), scenes.relations),
        graph_of(
            jax.tree.map(lambda value: widen(value, (1, more), (2, more)), graph.edges),
            widen(graph.nearer, *cube),
            widen(graph.margin, *cube),
        ),
    )
    plain, grown = settle_scenes(scenes), settle_scenes(wide)
    num = plain.root.shape[1]
    for name in ("resolved_slot", "resolved_score", "remaining", "root", "source"):
        np.testing.assert_array_equal(getattr(grown, name)[:, :num], getattr(plain, name), name)
    np.testing.assert_array_equal(grown.groups.status[:, :num], plain.groups.status)
    # Other shapes are summed in another order.
    np.testing.assert_allclose(
        number(grown.groups, "core")[:, :num], number(plain.groups, "core"), atol=ROUNDING
    )


@given(st.randoms(use_true_random=False))
def test_order_of_detections_does_not_matter(random):
    scenes = load_scenes()
    order = list(range(scenes.matched_slot.shape[1]))
    random.shuffle(order)
    rows = lambda value: value[:, order]  # noqa: E731
    shuffled = dataclasses.replace(
        scenes,
        undecided=jax.tree.map(rows, scenes.undecided),
        class_id=rows(scenes.class_id),
        matched_slot=rows(scenes.matched_slot),
        # Of two matches of one object the later lends its place; ranks keep who is later.
        matched_pass=rows(scenes.matched_pass * len(order) + np.arange(len(order), dtype=np.int32)),
        candidate=rows(scenes.candidate),
        pairs=jax.tree.map(rows, scenes.pairs),
        relations=jax.tree.map(lambda value: value[:, order][:, :, order], scenes.relations),
    )
    plain, mixed = settle_scenes(scenes), settle_scenes(shuffled)
    np.testing.assert_array_equal(mixed.resolved_slot, plain.resolved_slot[:, order])
    np.testing.assert_array_equal(mixed.remaining, plain.remaining[:, order])


@pytest.mark.parametrize("why", ["disabled", "no entries"])
def test_nothing_happens(why):
    scenes = load_scenes()
    changes = {"enabled": False} if why == "disabled" else {}
    if why == "no entries":
        none = np.zeros_like(scenes.undecided.present)
        scenes = change_parts(scenes, undecided={"present": none})
    settled = settle_scenes(scenes, **changes)
    assert np.all(settled.resolved_slot == -1)
    np.testing.assert_array_equal(settled.remaining, scenes.undecided.present)
    assert np.all(settled.groups.status == GroupStatus.NONE)


def test_too_large_groups_are_refused():
    with pytest.raises(ConfigError, match="group_candidates"):
        list_injections(7, 9)


@pytest.mark.parametrize("limits", [{"group_size": 1}, {"group_candidates": 1}])
def test_groups_beyond_the_limits_are_skipped(limits):
    groups = settle_scenes(load_scenes(), change_static(STATIC, **limits)).groups
    allowed = limits.get("group_size", 0)
    is_beyond = groups.num_detections > allowed
    assert np.any(is_beyond)
    assert np.all(groups.status[is_beyond] == GroupStatus.TOO_LARGE_OR_SMALL)
