import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.memory.bank import Permit
from remind_jax.remind.memory.channels import observe_wholes
from remind_jax.remind.memory.prototypes import empty_bank
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Background
from tests.remind.memory.recorded_banks import assert_as_recorded, descriptors_of, random_views
from tests.statics import change_static, make_static

pytestmark = pytest.mark.usefixtures("x64")

# Unequal capacities of the rings in shared slots.
STATIC = make_static(inner_ring_slots=(2, 1), outer_ring_slots=(3, 2), precision="float64")
FRAMES, OBJECTS, DIM = 50, 8, 4


def new_banks(static, num=OBJECTS, dim=DIM):
    slots = max(*static.switches.inner_ring_slots, *static.switches.outer_ring_slots)
    return empty_bank((2, 4, num), slots, dim, static.scalar)  # appearance stays empty


@functools.partial(jax.jit, static_argnames="static")
def watch(banks, views, ring_patches, solidity, permit, thresholds, static):
    """Shows `views` [T N 2 D] one frame after another; the banks after each."""

    def see(banks, frame):
        now, view, patches, solid, permit = frame
        shown = descriptors_of(
            view.shape[0], rings=view, rings_valid=patches > 0, ring_patches=patches,
            mask_quality=solid,
        )  # fmt: skip
        banks = observe_wholes(banks, shown, permit, now, static, thresholds)
        return banks, jax.tree.map(lambda leaf: leaf[:, 2:], banks)

    now = jnp.arange(len(views), dtype=jnp.int32)
    return jax.lax.scan(see, banks, (now, views, ring_patches, solidity, permit))[1]


def rules(**changes):
    return Thresholds(background=Background(**changes)).as_arrays(jnp.float64)


SETTINGS = {
    "published": ({}, {}),
    "merging": ({}, {"merge": 0.4, "promote_hits": 3, "merge_cap": 3}),
    "evicting": ({}, {"merge": 1.1, "promote_hits": 2, "create_quality": 0.0}),
    "oldest": ({"ring_evict": "oldest"}, {"merge": 1.1, "duplicate": 0.85}),
    "joining": (
        {},
        {"duplicate": 0.7, "stable_duplicate": 0.97, "promote_hits": 2, "update_rate_max": 0.9},
    ),
    "stable at rest": ({}, {"stable_update": False, "promote_hits": 1, "stable_duplicate": 0.7}),
    "off": ({}, {"enabled": False}),
}


def test_banks_are_as_recorded():
    """400 random updates per ring with banks that are always full."""
    for setting, (switches, changes) in SETTINGS.items():
        static = change_static(STATIC, **switches)
        rng = np.random.default_rng(11)
        views = random_views(rng, FRAMES, OBJECTS, 2, dim=DIM, spread=0.25)
        patches = rng.integers(0, 40, (FRAMES, OBJECTS, 2)).astype(np.int32)
        solidity = rng.uniform(0.4, 1.0, (FRAMES, OBJECTS))
        may_insert = rng.random((FRAMES, OBJECTS)) < 0.9
        permit = Permit(may_insert, np.where(may_insert, 1.0, 0.2))
        banks = new_banks(static)
        seen = watch(banks, views, patches, solidity, permit, rules(**changes), static)
        assert_as_recorded("background", setting, seen)
        for ring, slots in enumerate(
            (static.switches.inner_ring_slots, static.switches.outer_ring_slots)
        ):
            assert np.all(np.max(seen.size[:, :, ring], axis=(0, 2)) <= np.array(slots))
