"""Undecided tracks that do not fit while objects do; `test_tracker` has the other case."""

from __future__ import annotations

import dataclasses

import chex
import numpy as np

from remind_jax.decision import Outcome
from remind_jax.remind.memory.pending import Kind
from remind_jax.remind.method import METHOD
from remind_jax.remind.state import TrackerState
from tests import tiny_world as world
from tests.statics import change_static

SEED = 2
MANY = 100  # more than any id or class of the world


def fill_pending(state: TrackerState) -> TrackerState:
    """Strangers of another class in all free slots of undecided tracks."""
    tracks = state.pending
    free = tracks.kind == Kind.FREE
    numbers = MANY + np.arange(len(free), dtype=np.int32)
    filled = tracks.replaced(
        kind=np.where(free, np.int32(Kind.AMBIGUOUS), tracks.kind),
        id=np.where(free, numbers, tracks.id),
        class_id=np.where(free, np.int32(MANY), tracks.class_id),
    )
    return dataclasses.replace(state, pending=filled)


def count_tracks(state: TrackerState) -> int:
    return int((np.asarray(state.pending.kind) != Kind.FREE).sum())


def test_undecided_tracks_alone_overflow_and_change_nothing_else():
    frames = world.make_frames(40, SEED)
    states = world.run(frames)
    opens = [
        at
        for at in range(1, len(frames))
        if count_tracks(states[at]) > count_tracks(states[at - 1])
        and (states[at].decisions.outcome != Outcome.NEW).all()
    ]
    assert opens
    at = opens[-1]
    before = fill_pending(states[at - 1])
    (after,) = world.run([frames[at]], state=before)
    added = count_tracks(states[at]) - count_tracks(states[at - 1])
    assert after.overflow.pending == world.STATIC.num_pending + added
    assert after.overflow.objects == 0
    unchanged = dataclasses.replace(after, overflow=before.overflow)
    chex.assert_trees_all_equal(unchanged, before)

    # With room for them the tracks move as a whole, and the strangers with them.
    grown = METHOD.enlarge(
        before, change_static(world.STATIC, num_pending=2 * len(before.pending.id))
    )
    assert count_tracks(grown) == world.STATIC.num_pending
    np.testing.assert_array_equal(grown.pending.id[: world.STATIC.num_pending], before.pending.id)
