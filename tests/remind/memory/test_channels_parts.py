import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.memory.bank import Permit
from remind_jax.remind.memory.channels import observe_parts
from remind_jax.remind.memory.prototypes import empty_bank
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Parts
from tests.remind.memory.recorded_banks import assert_as_recorded, descriptors_of, random_views
from tests.statics import change_static, make_static

pytestmark = pytest.mark.usefixtures("x64")

STATIC = make_static(part_slots=(4, 2), precision="float64")
FRAMES, OBJECTS, NUM_PARTS, DIM = 30, 8, 3, 4


def new_banks(static, num=OBJECTS, dim=DIM):
    slots = max(static.switches.part_slots)
    return empty_bank((2, 1, num), slots, dim, static.scalar)


@functools.partial(jax.jit, static_argnames="static")
def watch(banks, parts, valid, permit, thresholds, static):
    """Shows parts [T N K D] one frame after another; the banks after each."""

    def see(banks, frame):
        now, vectors, exists, permit = frame
        shown = descriptors_of(
            vectors.shape[0], parts=vectors[:, None], parts_valid=exists[:, None]
        )
        banks = observe_parts(banks, shown, permit, now, static, thresholds)
        return banks, banks

    now = jnp.arange(len(parts), dtype=jnp.int32)
    return jax.lax.scan(see, banks, (now, parts, valid, permit))[1]


def rules(**changes):
    return Thresholds(parts=Parts(**changes)).as_arrays(jnp.float64)


SETTINGS = {
    "published": ({}, {}),
    "merging": ({}, {"merge": 0.3, "stable_merge": 0.2, "promote_hits": 2, "merge_cap": 3}),
    "equal weights": ({"part_merge": "equal"}, {"merge": 0.3, "stable_merge": 0.2}),
    "evicting": ({}, {"merge": 1.1, "stable_merge": 1.1, "promote_hits": 1, "duplicate": 0.85}),
    "redundant": (
        {"part_evict": "redundant"},
        {"merge": 1.1, "stable_merge": 1.1, "promote_hits": 2},
    ),
    "novel": ({"part_insert": "novel"}, {"novel": 0.5, "duplicate": 0.95}),
    "many to one": ({}, {"one_to_one": False, "duplicate": 0.8, "update_rate_max": 0.9}),
    "no promotion": ({}, {"promote_hits": 0, "duplicate": 0.8}),
}


def test_banks_are_as_recorded():
    """Up to 720 random parts with banks that are always full."""
    for setting, (switches, changes) in SETTINGS.items():
        static = change_static(STATIC, **switches)
        rng = np.random.default_rng(13)
        parts = random_views(rng, FRAMES, OBJECTS, NUM_PARTS, dim=DIM, spread=0.25)
        count = rng.integers(0, NUM_PARTS + 1, (FRAMES, OBJECTS))
        valid = np.arange(NUM_PARTS) < count[..., None]
        may_insert = rng.random((FRAMES, OBJECTS)) < 0.9
        permit = Permit(may_insert, np.where(may_insert, 1.0, 0.2))
        seen = watch(new_banks(static), parts, valid, permit, rules(**changes), static)
        assert_as_recorded("parts", setting, seen, qualities=False)
        assert np.all(np.max(seen.size, axis=(0, 2, 3)) <= np.array(static.switches.part_slots))
