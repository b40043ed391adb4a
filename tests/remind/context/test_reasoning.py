"""The whole package against an independent plain implementation of the rules, and at its edges."""

import dataclasses
import functools

import jax
import numpy as np
import pytest

from remind_jax.remind.context.evidence import ROUNDED_OBJECTS, join_links
from remind_jax.remind.context.hypotheses import Hypotheses
from remind_jax.remind.context.influence import Influence
from remind_jax.remind.context.veto import Veto
from tests.golden.load import load_expected

from .scenes import NUM, SLOTS, STATIC, Scene, example, list_scenes, read_on, thresholds, view_of

pytestmark = pytest.mark.usefixtures("x64")
ROUNDING = 1e-12  # float64 sums and products of some tens of numbers below 1
assert_close = functools.partial(np.testing.assert_allclose, rtol=0)
ALWAYS = ("soft_supported", "shortlist", "kept_count", "pruning", "strength")
GATED = (
    "bonus_raw",
    "score_sets",
    "support",
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
    expected = load_expected("context/scenes")
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


def test_switched_off_nothing_is_said():
    scene = list_scenes()[0]
    found = read_on(scene, influence={"enabled": False})
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(found.influence))
    assert_nothing_found(found.hypotheses)
    assert not np.any(found.veto)
    candidate = (scene.det_class[:, None] == scene.object_class) & (scene.object_class >= 0)
    np.testing.assert_array_equal(found.plausible, candidate)


@pytest.mark.parametrize(("num", "rounded"), [(ROUNDED_OBJECTS, True), (161, False)])
def test_strengths_of_few_objects_have_single_precision(num, rounded):
    view, rules = view_of(np.full((2, 2), 0.3)), thresholds().sets
    links = join_links(view, np.int32(num), static=STATIC, t=rules)
    assert links.strength[0, 1] == (np.float32(0.3) if rounded else np.sqrt(0.3 * 0.3))
