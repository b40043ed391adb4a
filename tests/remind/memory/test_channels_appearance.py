import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.memory.bank import Permit
from remind_jax.remind.memory.channels import (
    observe_wholes,
)
from remind_jax.remind.memory.prototypes import empty_bank
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Appearance
from tests.remind.memory.recorded_banks import assert_as_recorded, descriptors_of, random_views
from tests.statics import change_static, make_static

pytestmark = pytest.mark.usefixtures("x64")

STATIC = make_static(appearance_slots=(3, 2), precision="float64")
FRAMES, OBJECTS, DIM = 50, 8, 4


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
