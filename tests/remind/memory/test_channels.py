"""Banks of every channel, against what plain lists made of the same drawn observations."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.observation import Descriptors, RingPatches
from remind_jax.remind.memory import channels
from remind_jax.remind.memory.bank import Permit
from remind_jax.remind.memory.prototypes import empty_bank
from remind_jax.remind.thresholds import Thresholds
from tests.golden import load
from tests.statics import change_parts, make_static, only

pytestmark = pytest.mark.usefixtures("x64")
DIM = 4


@dataclasses.dataclass(frozen=True)
class Channel:
    """One kind of banks; of a setting, switches and changes of each group of thresholds."""

    draw: Callable[[np.random.Generator], dict[str, Any]]  # descriptors of all frames
    observe: Callable[..., Any]
    seed: int
    banks: int  # of an object
    shown: slice  # those of this channel
    slots: dict[str, tuple[int, int]]  # unequal capacities share slots
    groups: tuple[str, ...]
    settings: dict[str, tuple[dict[str, Any], ...]]
    qualities: bool = False  # whether banks count them


def random_views(rng, *shape, spread) -> np.ndarray:
    """Unit vectors around a few directions, so that duplicates, merges and novelties all occur."""
    centers = rng.standard_normal((5, DIM))
    centers /= np.linalg.norm(centers, axis=1, keepdims=True)
    views = centers[rng.integers(0, 5, shape)]
    views = views + spread * rng.random((*shape, 1)) * rng.standard_normal((*shape, DIM))
    return (views / np.linalg.norm(views, axis=-1, keepdims=True)).astype(np.float32)


def random_number(rng, *shape) -> np.ndarray:
    """Which of the last axis are there."""
    count = rng.integers(0, shape[-1] + 1, shape[:-1])
    return np.arange(shape[-1]) < count[..., None]


def draw_wholes(rng):
    views = random_views(rng, 50, 8, 2, spread=0.3)
    patches = rng.uniform(6, 30, (50, 8))
    valid = np.ones((50, 8, 2), bool)
    return {"appearance": views, "appearance_valid": valid, "patch_sum": patches}


def draw_rings(rng):
    views = random_views(rng, 50, 8, 2, spread=0.25)
    patches = rng.integers(0, 40, (50, 8, 2)).astype(np.int32)
    quality = rng.uniform(0.4, 1.0, (50, 8))
    seen = {"rings": views, "rings_valid": patches > 0, "ring_patches": patches}
    return seen | {"mask_quality": quality}


def draw_parts(rng):
    parts = random_views(rng, 30, 8, 3, spread=0.25)
    valid = random_number(rng, 30, 8, 3)
    return {"parts": parts[:, :, None], "parts_valid": valid[:, :, None]}


def draw_ring_prototypes(rng):
    vectors = random_views(rng, 40, 6, 2, 3, spread=0.3)
    return {"ring_prototypes": RingPatches(vectors, random_number(rng, 40, 6, 2, 3))}


CHANNELS = {
    "appearance": Channel(
        draw_wholes,
        channels.observe_wholes,
        seed=7,
        banks=4,
        shown=slice(4),
        slots={"appearance_slots": (3, 2)},
        groups=("appearance",),
        qualities=True,
        settings={
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
        },
    ),
    "background": Channel(
        draw_rings,
        channels.observe_wholes,
        seed=11,
        banks=4,
        shown=slice(2, 4),
        slots={"inner_ring_slots": (2, 1), "outer_ring_slots": (3, 2)},
        groups=("background",),
        qualities=True,
        settings={
            "published": ({}, {}),
            "merging": ({}, {"merge": 0.4, "promote_hits": 3, "merge_cap": 3}),
            "evicting": ({}, {"merge": 1.1, "promote_hits": 2, "create_quality": 0.0}),
            "oldest": ({"ring_evict": "oldest"}, {"merge": 1.1, "duplicate": 0.85}),
            "joining": (
                {},
                {
                    "duplicate": 0.7,
                    "stable_duplicate": 0.97,
                    "promote_hits": 2,
                    "update_rate_max": 0.9,
                },
            ),
            "stable at rest": (
                {},
                {"stable_update": False, "promote_hits": 1, "stable_duplicate": 0.7},
            ),
            "off": ({}, {"enabled": False}),
        },
    ),
    "parts": Channel(
        draw_parts,
        channels.observe_parts,
        seed=13,
        banks=1,
        shown=slice(1),
        slots={"part_slots": (4, 2)},
        groups=("parts",),
        settings={
            "published": ({}, {}),
            "merging": ({}, {"merge": 0.3, "stable_merge": 0.2, "promote_hits": 2, "merge_cap": 3}),
            "equal weights": ({"part_merge": "equal"}, {"merge": 0.3, "stable_merge": 0.2}),
            "evicting": (
                {},
                {"merge": 1.1, "stable_merge": 1.1, "promote_hits": 1, "duplicate": 0.85},
            ),
            "redundant": (
                {"part_evict": "redundant"},
                {"merge": 1.1, "stable_merge": 1.1, "promote_hits": 2},
            ),
            "novel": ({"part_insert": "novel"}, {"novel": 0.5, "duplicate": 0.95}),
            "many to one": ({}, {"one_to_one": False, "duplicate": 0.8, "update_rate_max": 0.9}),
            "no promotion": ({}, {"promote_hits": 0, "duplicate": 0.8}),
        },
    ),
    "ring_prototypes": Channel(
        draw_ring_prototypes,
        channels.observe_ring_prototypes,
        seed=29,
        banks=2,
        shown=slice(2),
        slots={"inner_prototype_slots": (4, 2), "outer_prototype_slots": (6, 3)},
        groups=("background", "ring_prototypes"),
        settings={
            "published": ({}, {}, {}),
            "joining": (
                {},
                {"merge": 0.5, "merge_cap": 3},
                {"stable_merge": 0.3, "promote_hits": 2},
            ),
            "evicting": ({}, {"merge": 1.1, "duplicate": 0.85}, {"promote_hits": 1}),
            "oldest": ({"ring_evict": "oldest"}, {"merge": 1.1, "stable_update": False}, {}),
            "at once": ({}, {"stable_duplicate": 0.8, "stable_rate_max": 0.9}, {"promote_hits": 0}),
        },
    ),
}


def descriptors_of(num: int, **fields) -> Descriptors:
    """Descriptors of `num` detections with nothing in them but the given fields."""
    empty = {
        "appearance": np.zeros((num, 2, DIM), np.float32),
        "appearance_valid": np.zeros((num, 2), bool),
        "rings": np.zeros((num, 2, DIM), np.float32),
        "rings_valid": np.zeros((num, 2), bool),
        "patch_sum": np.zeros(num),
        "ring_patches": np.zeros((num, 2), np.int32),
        "mask_quality": np.ones(num),
    }
    return only(Descriptors, **{**empty, **fields})


@functools.partial(jax.jit, static_argnames=("observe", "static"))
def watch(banks, drawn, permit, thresholds, observe, static):
    """Shows drawn descriptors `[T, N, ...]` one frame after another; the banks after each."""

    def see(banks, frame):
        now, fields, permit = frame
        shown = descriptors_of(len(permit.insert), **fields)
        banks = observe(banks, shown, permit, now, static, thresholds)
        return banks, banks

    now = jnp.arange(len(permit.insert), dtype=jnp.int32)
    return jax.lax.scan(see, banks, (now, drawn, permit))[1]


def assert_as_recorded(channel: str, setting: str, seen: Any, qualities: bool) -> None:
    """Compares banks `[T, S, C, O, ...]`, of which `S` are the work and the stable one.

    Recorded are those of some frames; every slot in use is compared, `qualities` if they count.
    """
    with np.load(load.ROOT / "banks" / f"{channel}.npz") as file:
        index, size, embedding, counts, sums = (
            file[f"{setting}.{name}"]
            for name in ("index", "size", "embedding", "counts", "qualities")
        )
    at = tuple(index.T.astype(int))
    bank = jax.tree.map(lambda leaf: np.asarray(leaf)[at], seen)
    np.testing.assert_array_equal(bank.size, size, setting)
    used = np.arange(bank.counts.shape[1]) < size[:, None]
    ours = jax.tree.map(lambda leaf: leaf[used], (bank.embedding, bank.counts, bank.qualities))
    np.testing.assert_array_equal(ours[1][:, :2], counts[:, :2], setting)  # hits, last seen
    np.testing.assert_allclose(ours[0], embedding, atol=1e-5, err_msg=setting)  # float32 steps
    np.testing.assert_allclose(np.linalg.norm(ours[0], axis=-1), 1.0, atol=1e-6)
    if qualities:
        np.testing.assert_array_equal(ours[1][:, 2], counts[:, 2], setting)
        np.testing.assert_allclose(ours[2], sums, atol=1e-9, err_msg=setting)


@pytest.mark.parametrize("name", CHANNELS)
def test_banks_are_as_recorded(name):
    """Hundreds of random updates of banks that are always full."""
    channel = CHANNELS[name]
    for setting, (switches, *changes) in channel.settings.items():
        slots = {name: switches.get(name, own) for name, own in channel.slots.items()}
        static = make_static(precision="float64", **{**slots, **switches})
        rng = np.random.default_rng(channel.seed)
        drawn = channel.draw(rng)
        num = jax.tree.leaves(drawn)[0].shape[:2]
        may_insert = rng.random(num) < 0.9
        permit = Permit(may_insert, np.where(may_insert, 1.0, 0.2))
        rules = change_parts(Thresholds(), **dict(zip(channel.groups, changes, strict=True)))
        most = max(max(pair) for pair in slots.values())
        banks = empty_bank((2, channel.banks, num[1]), most, DIM, static.scalar)
        rules = rules.as_arrays(jnp.float64)
        seen = watch(banks, drawn, permit, rules, channel.observe, static)
        seen = jax.tree.map(lambda leaf: leaf[:, :, channel.shown], seen)
        assert_as_recorded(name, setting, seen, channel.qualities)
