"""Room made before it is needed: one memory, small or foreseen, used up once."""

from __future__ import annotations

import dataclasses
import threading

import jax
import numpy as np
import pytest

from remind_jax.baselines.bank import METHOD
from remind_jax.session import spare_memory
from remind_jax.session.spare_memory import SpareMemory
from remind_jax.static import Static

SMALL = Static(num_detections=2, num_objects=4, feature_dim=3)
LARGE = SMALL.grow(num_objects=8)


def test_it_is_an_empty_memory_that_may_be_written_to():
    spare = SpareMemory(METHOD)
    spare.ask_for(LARGE, is_foreseen=False, waits=True)
    taken = spare.take(LARGE)
    for ours, expected in zip(*map(jax.tree.leaves, (taken, METHOD.init(LARGE))), strict=True):
        np.testing.assert_array_equal(ours, expected)
        assert ours.flags.writeable
    assert spare.take(LARGE) is None


def test_other_capacities_are_not_served():
    spare = SpareMemory(METHOD)
    spare.ask_for(LARGE, is_foreseen=False, waits=True)
    assert spare.take(SMALL) is None
    spare.ask_for(LARGE, is_foreseen=False, waits=True)
    assert spare.take(LARGE) is not None


def test_a_large_one_is_made_only_when_it_is_foreseen(monkeypatch):
    monkeypatch.setattr(spare_memory, "MOST_IDLE_BYTES", 1000)
    host = dataclasses.replace(METHOD.host, count_bytes=lambda static: 1001)
    spare = SpareMemory(dataclasses.replace(METHOD, host=host))
    spare.ask_for(LARGE, is_foreseen=False, waits=True)
    assert spare.take(LARGE) is None
    spare.ask_for(LARGE, is_foreseen=True, waits=True)
    assert spare.take(LARGE) is not None


def test_one_is_made_at_a_time_and_nobody_waits_for_it():
    go, made = threading.Event(), []

    def init(static: Static):
        go.wait(60)
        made.append(static)
        return METHOD.init(static)

    spare = SpareMemory(dataclasses.replace(METHOD, init=init))
    spare.ask_for(LARGE, is_foreseen=False)
    assert spare.take(LARGE) is None
    spare.ask_for(SMALL, is_foreseen=False)  # the thread is at work
    go.set()
    assert spare._thread is not None
    spare._thread.join()
    assert made == [LARGE]


@pytest.mark.parametrize("waits", [True, False])
def test_what_cannot_be_made_is_left_to_the_frame_that_needs_it(waits):
    def init(static: Static):
        raise MemoryError

    spare = SpareMemory(dataclasses.replace(METHOD, init=init))
    spare.ask_for(LARGE, is_foreseen=False, waits=waits)
    assert spare._thread is not None
    spare._thread.join()
    assert spare.take(LARGE) is None
