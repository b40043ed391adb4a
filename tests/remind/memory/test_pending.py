"""Tracks of undecided detections, against what plain lists made of the same drawn frames.

Rules: method.md#pending-joins, method.md#birth-origins.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.decision import NUM_OPTIONS
from remind_jax.numerics.absent import NO_ID
from remind_jax.remind.memory.pending import (
    Items,
    Kind,
    end_tracks,
    join_tracks,
    no_pending,
    open_tracks,
    write_tracks,
)
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.undecided.provisional_commit import claim_origins
from tests.golden.load import load_expected
from tests.statics import change_parts

pytestmark = pytest.mark.usefixtures("x64")

SLOTS, NUM, FRAMES, WORLDS = 80, 6, 20, 6
NUM_KNOWN, NUM_CLASSES = 6, 2
MOST_IDS = NUM * FRAMES  # of each kind
SETTINGS = {
    "published": {},
    "loose": {
        "ambiguous_min_overlap": 0.0,
        "ambiguous_min_visual": 0.1,
        "ambiguous_min_total": 0.3,
        "provisional_min_visual": 0.1,
        "provisional_min_total": 0.3,
        "origin_min_overlap": 0.3,
    },
    "strict": {
        "provisional_without_parent": False,
        "ambiguous_matching": False,
        "origin_min_overlap": 0.9,
    },
}


@functools.partial(jax.jit, static_argnames="solver")
def step(tracks, items, visual, births, rules, solver):
    ended = claim_origins(tracks, births, items.class_id, items.known_id, rules)
    tracks = end_tracks(tracks, ended)
    joined = join_tracks(tracks, items, visual, rules, solver=solver)
    slot, needed = open_tracks(tracks, items, joined)
    waiting = items.kind != Kind.FREE
    slot = jnp.where(waiting, slot, SLOTS)
    written = write_tracks(tracks, items, slot, joined)
    ids = written.id.at[slot].get(mode="fill", fill_value=NO_ID)
    return written, jnp.where(waiting, ids, NO_ID), needed


def draw_frame(rng: np.random.Generator, tied: bool) -> tuple[Items, np.ndarray, np.ndarray]:
    """Detections that wait, those that found objects, and visual scores `[kind, id, N]`.

    Tied scores have few values, so that assignments tie, and place does not tell them apart.
    """

    def draw_scores(*shape: int) -> np.ndarray:
        return rng.integers(2, 5, shape) / 4 if tied else rng.uniform(0.3, 1.0, shape)

    kind = rng.choice([Kind.FREE, Kind.AMBIGUOUS, Kind.PROVISIONAL], NUM, p=[0.3, 0.3, 0.4])
    num_known = rng.integers(np.where(kind == Kind.AMBIGUOUS, 2, 0), NUM_OPTIONS + 1)
    is_known = np.arange(NUM_OPTIONS) < num_known[:, None]
    names = rng.permuted(np.tile(np.arange(NUM_KNOWN), (NUM, 1)), axis=1)[:, :NUM_OPTIONS]
    columns: dict[str, Any] = {
        "kind": kind.astype(np.int32),
        "class_id": rng.integers(NUM_CLASSES, size=NUM).astype(np.int32),
        "known_id": np.where(is_known, names, NO_ID).astype(np.int32),
        "known_score": np.where(is_known, draw_scores(NUM, NUM_OPTIONS), 0.0),
        "from_parent": rng.random(NUM) < 0.3,
        "center": np.zeros((NUM, 2)) if tied else rng.uniform(0, 60, (NUM, 2)),
        "area": np.full(NUM, 64.0) if tied else rng.uniform(50, 900, NUM),
    }
    births = (kind == Kind.FREE) & (rng.random(NUM) < 0.5)
    return Items.begun(**columns), births, draw_scores(len(Kind), MOST_IDS, NUM)


@pytest.mark.parametrize("tied", [False, True], ids=["distinct", "tied"])
@pytest.mark.parametrize("setting", SETTINGS)
def test_tracks_are_those_of_plain_lists(setting, tied):
    """120 frames of six detections."""
    rules = change_parts(Thresholds(), pending=SETTINGS[setting]).as_arrays(jnp.float64).pending
    case = list(SETTINGS).index(setting), int(tied)
    expected = {name: values[case] for name, values in load_expected("pending/tracks").items()}
    for world in range(WORLDS):
        rng, tracks = np.random.default_rng(world), no_pending(SLOTS, jnp.dtype("float64"))
        for frame in range(FRAMES):
            items, births, scores = draw_frame(rng, tied)
            visual = scores[np.asarray(tracks.kind), np.asarray(tracks.id)].T
            tracks, ids, needed = step(tracks, items, visual, births, rules, solver="jax")
            assert ids.tolist() == expected["ids"][world, frame].tolist(), (world, frame)
            assert needed == expected["num_tracks"][world, frame] <= SLOTS
        for name in ("hits", "class_id"):
            left = np.full((len(Kind), MOST_IDS), NO_ID)
            used = np.asarray(tracks.kind) != Kind.FREE
            at = np.asarray(tracks.kind)[used], np.asarray(tracks.id)[used]
            left[at] = np.asarray(getattr(tracks, name))[used]
            np.testing.assert_array_equal(left, expected[name][world], name)
        assert tracks.next_id.tolist() == expected["next_id"][world].tolist()
