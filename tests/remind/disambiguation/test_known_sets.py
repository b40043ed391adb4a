import dataclasses

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.remind.disambiguation.joint_assignments import NUMBERS, GroupStatus
from remind_jax.remind.stages import MatchOrigin

from .scenes import (
    load_scenes,
    load_stored,
    settle_scenes,
)

ROUNDING = 1e-12  # float64 sums of a hundred terms below 30 in another order


def number(groups, name):
    return groups.numbers[..., NUMBERS.index(name)]


def expected(name):
    return load_stored()[f"expected.{name}"]


@pytest.mark.usefixtures("x64")
def test_frozen_scenes_are_settled_as_by_the_plain_rules():
    settled = settle_scenes(load_scenes())
    np.testing.assert_array_equal(settled.resolved_slot, expected("resolved_slot"))
    np.testing.assert_array_equal(settled.remaining, expected("remaining"))
    sources = np.array([MatchOrigin.NONE, MatchOrigin.DISTANCE_FULL, MatchOrigin.DISTANCE_PARTIAL])
    np.testing.assert_array_equal(settled.source, sources[expected("full")])
    np.testing.assert_array_equal(settled.root, expected("root"))
    np.testing.assert_array_equal(settled.groups.status, expected("status"))
    rated = settled.groups.status > GroupStatus.NO_ASSIGNMENT
    voting = np.where(rated, np.sum(settled.groups.anchor >= 0, axis=-1), 0)
    assert np.all(voting <= expected("n_anchor"))  # where an object that counts twice does so
    numbers = [number(settled.groups, name) for name in NUMBERS if name != "second"]
    np.testing.assert_allclose(np.stack(numbers, -1), expected("numbers"), atol=ROUNDING)
    np.testing.assert_allclose(settled.resolved_score, expected("resolved_score"), atol=ROUNDING)


@given(st.randoms(use_true_random=False))
def test_order_of_detections_does_not_matter(random):
    scenes = load_scenes("float32")
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
    plain, mixed = settle_scenes(scenes, "float32"), settle_scenes(shuffled, "float32")
    np.testing.assert_array_equal(mixed.resolved_slot, plain.resolved_slot[:, order])
    np.testing.assert_array_equal(mixed.remaining, plain.remaining[:, order])


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({"min_evidence": 1e3}, GroupStatus.LOW_EVIDENCE),
        ({"min_score": 2.0}, GroupStatus.LOW_SCORE),
        ({"min_core": 2.0}, GroupStatus.LOW_CORE_SCORE),
        ({"min_core_gap": 2.0}, GroupStatus.LOW_CORE_GAP),
        ({"full_gap": 2.0}, GroupStatus.PARTIAL_RESOLVED),
    ],
)
def test_each_test_can_reject(changes, status):
    scenes = load_scenes("float32")
    before, after = settle_scenes(scenes, "float32"), settle_scenes(scenes, "float32", **changes)
    accepted = before.groups.status >= GroupStatus.RESOLVED
    assert accepted.sum() >= 10
    assert np.all(after.groups.status[accepted] == status)


@pytest.mark.parametrize("limits", [{"group_size": 1}, {"group_candidates": 1}])
def test_groups_beyond_the_limits_are_skipped(limits):
    scenes = load_scenes("float32")
    settled = settle_scenes(scenes, "float32", limits)
    np.testing.assert_array_equal(settled.remaining, scenes.undecided.present)
    skipped = [GroupStatus.NONE, GroupStatus.NOT_CLOSED, GroupStatus.TOO_LARGE_OR_SMALL]
    assert np.isin(settled.groups.status, skipped).all()
