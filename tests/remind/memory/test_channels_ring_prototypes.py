import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.observation import RingPatches
from remind_jax.remind.memory.bank import Permit
from remind_jax.remind.memory.channels import observe_ring_prototypes
from remind_jax.remind.memory.prototypes import empty_bank
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Background
from remind_jax.remind.thresholds.perception import RingPrototypes
from tests.remind.memory.recorded_banks import assert_as_recorded, descriptors_of, random_views
from tests.statics import change_static, make_static

pytestmark = pytest.mark.usefixtures("x64")

STATIC = make_static(
    inner_prototype_slots=(4, 2), outer_prototype_slots=(6, 3), precision="float64"
)
FRAMES, OBJECTS, RINGS, KEPT, DIM = 40, 6, 2, 3, 4

SETTINGS = {
    "published": ({}, {}, {}),
    "joining": ({}, {"merge": 0.5, "merge_cap": 3}, {"stable_merge": 0.3, "promote_hits": 2}),
    "evicting": ({}, {"merge": 1.1, "duplicate": 0.85}, {"promote_hits": 1}),
    "oldest": ({"ring_evict": "oldest"}, {"merge": 1.1, "stable_update": False}, {}),
    "at once": ({}, {"stable_duplicate": 0.8, "stable_rate_max": 0.9}, {"promote_hits": 0}),
}


@functools.partial(jax.jit, static_argnames="static")
def watch(vectors, valid, permit, thresholds, static):
    """Shows prototypes [T N R M D] one frame after another; the banks after each."""

    def see(banks, frame):
        now, seen, exists, permit = frame
        shown = descriptors_of(len(seen), ring_prototypes=RingPatches(seen, exists))
        banks = observe_ring_prototypes(banks, shown, permit, now, static, thresholds)
        return banks, banks

    slots = max(*static.switches.inner_prototype_slots, *static.switches.outer_prototype_slots)
    leading = (vectors.shape[2], vectors.shape[1])
    empty = empty_bank((2, *leading), slots, vectors.shape[-1], static.scalar)
    now = jnp.arange(len(vectors), dtype=jnp.int32)
    return jax.lax.scan(see, empty, (now, vectors, valid, permit))[1]


def test_banks_are_as_recorded():
    """Up to 1,440 random prototypes with banks that are always full."""
    for setting, (switches, background, changes) in SETTINGS.items():
        static = change_static(STATIC, **switches)
        rng = np.random.default_rng(29)
        vectors = random_views(rng, FRAMES, OBJECTS, RINGS, KEPT, dim=DIM, spread=0.3)
        count = rng.integers(0, KEPT + 1, (FRAMES, OBJECTS, RINGS))
        valid = np.arange(KEPT) < count[..., None]
        may_insert = rng.random((FRAMES, OBJECTS)) < 0.9
        permit = Permit(may_insert, np.where(may_insert, 1.0, 0.2))
        rules = Thresholds(
            background=Background(**background), ring_prototypes=RingPrototypes(**changes)
        )
        seen = watch(vectors, valid, permit, rules.as_arrays(jnp.float64), static)
        assert_as_recorded("ring_prototypes", setting, seen, qualities=False)
