"""The whole package against an independent plain implementation of the rules, and at its edges."""

import dataclasses
import functools

import jax
import numpy as np
import pytest

from remind_jax.remind.context.hypotheses import Hypotheses
from remind_jax.remind.context.influence import Influence
from remind_jax.remind.context.veto import Veto

from .scenes import (
    NUM,
    SLOTS,
    STATIC,
    Scene,
    example,
    list_scenes,
    load_expected,
    load_scenes,
    read_context,
    read_on,
    thresholds,
)

pytestmark = pytest.mark.usefixtures("x64")
ROUNDING = 1e-12  # float64 sums and products of some tens of numbers below 1
assert_close = functools.partial(np.testing.assert_allclose, rtol=0)
ALWAYS = ("soft_supported", "shortlist", "kept_count", "pruning", "strength")
GATED = (
    "bonus_raw",
    "score_sets",
    "support",
    "contradiction",
    "compat_rel",
    "compat_band",
    "kernel_raw",
)


def empty_scene() -> Scene:
    """No object, no detection."""
    blank = jax.tree.map(np.zeros_like, example())
    nobody, nothing = np.full(SLOTS, -1, np.int32), np.full(NUM, -1, np.int32)
    return dataclasses.replace(blank, object_class=nobody, det_class=nothing)


def assert_nothing_found(hypotheses: Hypotheses) -> None:
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(hypotheses))


def assert_silent(influence: Influence) -> None:
    """A context without a say: no bonus, no protection by it."""
    assert not influence.global_ok
    for name in GATED:
        assert not np.any(getattr(influence, name)), name


def test_frozen_scenes_are_read_as_by_the_plain_rules():
    expected = load_expected()
    for index, scene in enumerate(list_scenes()):
        found = read_on(scene)
        want = {name: values[index] for name, values in expected.items()}
        hypotheses, influence = found.hypotheses, found.influence
        np.testing.assert_array_equal(hypotheses.valid, want["hyp_valid"])
        np.testing.assert_array_equal(hypotheses.members, want["hyp_members"])
        np.testing.assert_array_equal(hypotheses.detections, want["hyp_detections"])
        np.testing.assert_array_equal(hypotheses.size, want["hyp_members"].sum(1))
        assert_close(hypotheses.score, want["hyp_score"], atol=ROUNDING)
        for name in ("coverage", "density", "maturity"):
            value = getattr(hypotheses, name)
            assert_close(value, want[name], atol=ROUNDING, err_msg=name)
        for name in (*ALWAYS, *GATED, "quality", "global_ok"):
            value = np.asarray(getattr(influence, name), float)
            assert_close(value, want[name], atol=ROUNDING, err_msg=name)
        np.testing.assert_array_equal(found.veto, want["veto"])
        np.testing.assert_array_equal(influence.has_pack, scene.object_class >= 0)
        candidate = (scene.det_class[:, None] == scene.object_class) & (scene.object_class >= 0)
        np.testing.assert_array_equal(found.plausible, candidate & (found.veto == Veto.NONE))


def test_frozen_scenes_show_every_effect():
    scenes, expected = load_scenes(), load_expected()
    assert np.all(np.bincount(expected["veto"].ravel(), minlength=3) >= 10)
    assert np.sum(expected["bonus_raw"] > 0) >= 50
    assert np.sum(expected["bonus_raw"] < 0) >= 10
    assert 10 <= np.sum(expected["global_ok"]) <= len(expected["global_ok"]) - 10
    classes = scenes.object_class
    largest = [np.bincount(row[row >= 0]).max() for row in classes]
    assert np.sum(np.array(largest) > STATIC.switches.class_pool) >= 3
    anchors = scenes.anchors.sum(1)
    assert np.sum(anchors == 0) >= 5
    assert np.sum(anchors >= STATIC.switches.set_kernel) >= 2
    assert np.sum((scenes.det_class >= 0).sum(1) == 1) >= 2


def test_padding_and_batches_change_nothing():
    """All scenes at once, with more slots; notes about edges that do not exist do not count."""
    scenes, dets, more = load_scenes(), 2, 7
    noise = np.random.default_rng(0)

    def widen(value, *axes):
        pad = [(0, 0)] * value.ndim
        for axis, count in axes:
            pad[axis] = (0, count)
        old = np.pad(np.ones(value.shape, bool), pad)
        return np.where(
            old, np.pad(value, pad), noise.integers(0, 9, old.shape).astype(value.dtype)
        )

    wide = Scene(
        count=np.pad(scenes.count, ((0, 0), (0, more), (0, more))),
        edge_time=widen(scenes.edge_time, (1, more), (2, more)),
        edge_order=widen(scenes.edge_order, (1, more), (2, more)),
        episodes=widen(scenes.episodes, (1, more)),
        object_class=np.pad(scenes.object_class, ((0, 0), (0, more)), constant_values=-1),
        anchors=np.pad(scenes.anchors, ((0, 0), (0, more))),
        det_class=np.pad(scenes.det_class, ((0, 0), (0, dets)), constant_values=-1),
        det_score=widen(scenes.det_score, (1, dets)),
        score=widen(scenes.score, (1, dets), (2, more)),
    )
    read = jax.jit(jax.vmap(functools.partial(read_context, static=STATIC), in_axes=(0, None)))
    together = jax.device_get(read(wide, thresholds()))
    alone = [read_on(scene) for scene in list_scenes()]
    alone = jax.tree.map(lambda *leaves: np.stack(leaves), *alone)

    def compare(path, narrow, broad):
        grown = [(0, long - short) for short, long in zip(narrow.shape, broad.shape, strict=True)]
        # Sums over slots may be taken in another order; nothing else may differ.
        assert_close(
            np.asarray(broad, float), np.pad(np.asarray(narrow, float), grown), atol=1e-15,
            err_msg=jax.tree_util.keystr(path),
        )  # fmt: skip

    jax.tree_util.tree_map_with_path(compare, alone, together)


def test_worked_example():
    """method.md#example-company; rounded to six places."""
    found = read_on(example())
    hypotheses, influence = found.hypotheses, found.influence
    assert hypotheses.valid.sum() == 7
    sets = [set(np.flatnonzero(row)) for row in hypotheses.members[:7]]
    assert sets[:2] == [{0, 1, 3}, {0, 3}]
    assert {frozenset(one) for one in sets[2:4]} == {frozenset({0, 1}), frozenset({1, 3})}
    assert all(2 in one for one in sets[4:])
    scores = [0.632158, 0.423142, 0.408374, 0.408374, 0, 0, 0]
    assert_close(hypotheses.score[:7], scores, atol=1e-6)
    assert_close(influence.quality, 0.642778, atol=1e-6)
    assert influence.global_ok
    np.testing.assert_array_equal(np.flatnonzero(influence.shortlist), [0, 1, 3])
    assert_close(influence.bonus_raw[:3], [0.103809, 0.115689, 0], atol=1e-6)
    assert_close(influence.support[:3], [0.8075, 0.899916, 0], atol=1e-6)
    assert_close(influence.compat_rel[1:3], [1, 0.146064], atol=1e-6)
    assert_close(influence.strength[:3], [0.470257, 0.731569, 0.731569], atol=1e-6)
    assert_close(influence.pruning[1:3], 0.5, atol=0)
    assert not np.any(influence.contradiction)
    assert not np.any(found.veto)


@pytest.mark.parametrize(
    "changed",
    [{"min_best_score": 0.6322}, {"min_coverage": 1.01}, {"min_size": 4}, {"min_quality": 0.643}],
)
def test_poor_context_does_not_count(changed):
    found = read_on(example(), influence=changed).influence
    assert not found.global_ok
    assert not any(np.any(getattr(found, name)) for name in GATED)


def test_empty_memory():
    scene = dataclasses.replace(empty_scene(), det_class=example().det_class)
    found = read_on(scene)
    assert_nothing_found(found.hypotheses)
    assert_silent(found.influence)
    assert found.influence.enabled
    assert found.influence.quality == 0
    assert not np.any(found.plausible | found.influence.has_pack)


@pytest.mark.parametrize("det_class", [-1, 7])
def test_no_detection_of_a_known_class(det_class):
    """No detection at all, or only of a class that no object has: classes are still summed up."""
    scene = dataclasses.replace(example(), det_class=np.full(NUM, det_class, np.int32))
    found = read_on(scene)
    assert_nothing_found(found.hypotheses)
    assert_silent(found.influence)
    # Anchors 0 and 3 speak for object 1 alone: one of two objects of its class is ruled out, and
    # of the quality only the weight of the pruning is left: 0.15 * mean(0.5, 0, 0, 0).
    assert_close(found.influence.pruning[:5], [0, 0.5, 0.5, 0, 0], atol=0)
    kept = found.influence.kept_count[:5]
    np.testing.assert_array_equal(kept, [1, 1, 1, 1, 1])
    assert_close(found.influence.quality, 0.15 * 0.125, atol=1e-12)
    assert not np.any(found.veto)


def test_fewer_slots_than_detections_of_a_class():
    """Detections beyond the slots still say that the class has more of them than objects."""
    stored, scene = np.arange(SLOTS) < 2, example()
    scene = dataclasses.replace(
        scene,
        count=np.where(stored[:, None] & stored, scene.count, 0),
        episodes=np.where(stored, scene.episodes, 0),
        anchors=scene.anchors & stored,
        object_class=np.where(stored, 0, -1).astype(np.int32),
        det_class=np.where(np.arange(NUM) < 3, 0, -1).astype(np.int32),
    )
    few = {
        name: getattr(scene, name)[:2]
        for name in ("count", "edge_time", "edge_order", "episodes", "object_class", "anchors")
    }
    few |= {name: few[name][:, :2] for name in ("count", "edge_time", "edge_order")}
    tight = read_on(dataclasses.replace(scene, **few, score=scene.score[:, :2])).hypotheses
    roomy = read_on(scene).hypotheses
    assert roomy.valid.sum() > 1
    for name in ("valid", "score", "size", "detections"):
        np.testing.assert_array_equal(getattr(tight, name), getattr(roomy, name), name)


def test_switched_off_nothing_is_said():
    scene = list_scenes()[0]
    found = read_on(scene, influence={"enabled": False})
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(found.influence))
    assert_nothing_found(found.hypotheses)
    assert not np.any(found.veto)
    candidate = (scene.det_class[:, None] == scene.object_class) & (scene.object_class >= 0)
    np.testing.assert_array_equal(found.plausible, candidate)
