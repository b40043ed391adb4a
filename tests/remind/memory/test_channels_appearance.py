import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.memory.bank import Permit
from remind_jax.remind.memory.channels import (
    GLOBAL,
    TRIMMED,
    appearance_quality,
    observe_wholes,
)
from remind_jax.remind.memory.prototypes import STABLE, WORK, confidence, empty_bank
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Appearance
from tests.remind.memory.recorded_banks import assert_as_recorded, descriptors_of, random_views
from tests.statics import change_static, make_static

pytestmark = pytest.mark.usefixtures("x64")

STATIC = make_static(appearance_slots=(3, 2), precision="float64")
FRAMES, OBJECTS, DIM = 50, 8, 4
SIDE = {"work": WORK, "stable": STABLE}


def new_banks(static, num=OBJECTS, dim=DIM):
    slots = max(static.switches.appearance_slots)
    return empty_bank((2, 4, num), slots, dim, static.scalar)  # the rings stay empty


@functools.partial(jax.jit, static_argnames="static")
def watch(banks, views, patch_sum, permit, thresholds, static):
    """Shows `views` [T N 2 D] one frame after another; the banks after each."""

    def see(banks, frame):
        now, view, patches, permit = frame
        seen = jnp.ones(view.shape[:2], bool)
        num = view.shape[0]
        shown = descriptors_of(num, appearance=view, appearance_valid=seen, patch_sum=patches)
        banks = observe_wholes(banks, shown, permit, now, static, thresholds)
        return banks, banks

    now = jnp.arange(len(views), dtype=jnp.int32)
    return jax.lax.scan(see, banks, (now, views, patch_sum, permit))[1]


def rules(**changes):
    return Thresholds(appearance=Appearance(**changes)).as_arrays(jnp.float64)


SETTINGS = {
    "published": ({}, {}),
    "merging": ({}, {"merge": 0.4, "stable_merge": 0.3, "promote_hits": 2}),
    "evicting": ({}, {"merge": 1.1, "stable_merge": 1.1, "promote_hits": 2}),
    "oldest": (
        {"appearance_evict": "oldest", "appearance_stable_evict": "oldest"},
        {"merge": 1.1, "stable_merge": 1.1, "promote_hits": 2},
    ),
    "capped": (
        {"appearance_merge": "capped"},
        {"merge": 0.5, "stable_merge": 0.4, "merge_cap": 3, "promote_hits": 3},
    ),
    "novel": ({"appearance_insert": "novel"}, {"novel": 0.7, "merge": 0.5}),
    "left alone": ({}, {"refresh_work": False}),
    "gated": ({}, {"gated_update": True, "duplicate": 0.8, "promote_hits": 3}),
    "joining": ({}, {"stable_duplicate": 0.97, "duplicate": 0.7, "promote_hits": 2}),
    "no promotion": ({}, {"promote_hits": 0}),
    "room for one": ({"appearance_slots": (1, 1)}, {"merge": 0.0, "promote_hits": 2}),
}


def test_banks_are_as_recorded():
    """400 random updates per channel with banks that are always full."""
    for setting, (switches, changes) in SETTINGS.items():
        static = change_static(STATIC, **switches)
        rng = np.random.default_rng(7)
        views = random_views(rng, FRAMES, OBJECTS, 2, dim=DIM, spread=0.3)
        patches = rng.uniform(6, 30, (FRAMES, OBJECTS))
        may_insert = rng.random((FRAMES, OBJECTS)) < 0.9
        permit = Permit(may_insert, np.where(may_insert, 1.0, 0.2))
        seen = watch(new_banks(static), views, patches, permit, rules(**changes), static)
        assert_as_recorded("appearance", setting, seen)


def test_example_of_the_page():
    """method.md#appearance-learning: 16 effective patches, one view, then five of another."""
    static = make_static(precision="float64")
    views = np.zeros((6, 1, 2, 2), np.float32)
    views[0, ..., 0] = 1
    views[1:] = [0.96, 0.28]
    permit = Permit(np.ones((6, 1), bool), np.ones((6, 1)))
    seen = watch(new_banks(static, 1, 2), views, np.full((6, 1), 16.0), permit, rules(), static)

    def at(frame, channel, bank):
        ours = jax.tree.map(lambda leaf: np.asarray(leaf[frame, SIDE[bank], channel, 0]), seen)
        stability = np.asarray(confidence(ours, jnp.int32(5)))[0]
        quality = ours.quality_sum[0]
        return int(ours.size), int(ours.hits[0]), quality, stability, ours.embedding[0].tolist()

    def expect(found, size, hits, quality_sum, stability, embedding):
        assert found[:2] == (size, hits)
        np.testing.assert_allclose(found[2:4], (quality_sum, stability), atol=1e-9)
        np.testing.assert_allclose(found[4], embedding, atol=1e-6)

    expect(at(1, GLOBAL, "work"), 1, 2, 1.0, 0.2, [0.989949, 0.141421])
    expect(at(2, GLOBAL, "work"), 1, 3, 1.5, 0.3, [0.977434, 0.211242])
    expect(at(3, GLOBAL, "work"), 1, 4, 2.0, 0.4, [0.969327, 0.245776])
    # Five hits, but a mean quality of 0.5 is too low to promote.
    expect(at(4, GLOBAL, "work"), 1, 5, 2.5, 0.5, [0.964815, 0.262929])
    expect(at(5, GLOBAL, "work"), 1, 6, 3.0, 0.5, [0.962445, 0.271475])
    assert at(5, GLOBAL, "stable")[0] == 0

    expect(at(1, TRIMMED, "work"), 1, 2, 1.1, 0.22, [0.987828, 0.155548])
    expect(at(2, TRIMMED, "work"), 1, 3, 1.65, 0.33, [0.974486, 0.224449])
    expect(at(3, TRIMMED, "work"), 1, 4, 2.2, 0.44, [0.966913, 0.255106])
    # A mean of exactly 0.55 is enough: the prototype moves.
    expect(at(4, TRIMMED, "stable"), 1, 5, 2.75, 0.55, [0.963190, 0.268820])
    assert at(4, TRIMMED, "work")[0] == 0
    expect(at(5, TRIMMED, "stable"), 1, 6, 3.3, 0.55, [0.961452, 0.274974])


@pytest.mark.parametrize(
    ("patches", "in_global", "in_trimmed"), [(12, 0, 0), (13, 0, 1), (14, 1, 1)]
)
def test_small_objects_may_have_no_prototype(patches, in_global, in_trimmed):
    static = make_static(precision="float64")
    permit = Permit(np.ones((1, 1), bool), np.ones((1, 1)))
    views = np.ones((1, 1, 2, 1), np.float32)
    seen = watch(
        new_banks(static, 1, 1), views, np.full((1, 1), float(patches)), permit, rules(), static
    )
    assert seen.size[0, WORK, :2, 0].tolist() == [in_global, in_trimmed]


def test_a_large_duplicate_replaces_the_prototype():
    static = make_static(precision="float64")
    permit = Permit(np.ones((2, 1), bool), np.ones((2, 1)))
    views = np.zeros((2, 1, 2, 2), np.float32)
    views[0], views[1] = [1, 0], [0.96, 0.28]
    seen = watch(new_banks(static, 1, 2), views, np.full((2, 1), 24.0), permit, rules(), static)
    np.testing.assert_allclose(seen.embedding[1, WORK, GLOBAL, 0, 0], [0.96, 0.28], atol=1e-7)


@pytest.mark.parametrize(("patches", "quality"), [(0, 0), (8, 0), (16, 0.5), (24, 1), (99, 1)])
def test_quality_rises_with_the_patches(patches, quality):
    found = appearance_quality(np.array([float(patches)]), rules().appearance)[0]
    np.testing.assert_allclose(found, [quality, 0.1 + 0.9 * quality], atol=1e-12)


def test_quality_is_a_step_without_a_span():
    t = rules(patches_min=10.0, patches_full=10.0).appearance
    found = appearance_quality(np.array([9.9, 10.0]), t)
    np.testing.assert_allclose(found, [[0, 0.1], [1, 1]], atol=1e-12)
