"""How a batch is shared between the cores of a CPU, with a program that says what it was given."""

import types

import numpy as np
import pytest

from remind_jax.sweeps import batches
from remind_jax.sweeps.program import Answers
from tests.sweeps.tiny_sweep import CONFIG

FRAMES = {"number": np.arange(20)}  # two calls of the program
STATIC = CONFIG.static


def settings_of(number):
    return [{"matching.match": 0.001 * index} for index in range(number)]


@pytest.fixture
def told(monkeypatch):
    """Sizes of the programs that were asked for; the setting 0.004 lacks slots up to 64 objects."""
    sizes = []

    def compile_follow(method, static, num, thresholds, frames):
        sizes.append(num)

        def run(states, thresholds, part):
            said = np.rint(1000 * np.asarray(thresholds.matching.match)).astype(int)
            said = np.broadcast_to(said, (len(part["number"]), num))
            lacking = 65 * ((said == 4) & (static.num_objects < 65))
            ids = 100 * said + np.asarray(part["number"])[:, None]
            return states, Answers(ids[..., None], ids[..., None], ids[..., None], lacking, 0 * ids)

        return types.SimpleNamespace(run=run, num_bytes=100 * num)

    monkeypatch.setattr(batches, "compile_follow", compile_follow)
    monkeypatch.setattr(batches, "empty_memories", lambda *given: np.zeros(1))
    return sizes


@pytest.mark.parametrize(("lanes", "sizes"), [(1, [7]), (2, [4, 3]), (3, [3, 2, 2]), (9, [1] * 7)])
def test_every_lane_has_an_equal_share(monkeypatch, lanes, sizes):
    monkeypatch.setattr(batches, "count_lanes", lambda: lanes)
    assert batches.share_lanes(7) == sizes


@pytest.mark.parametrize("lanes", [1, 2, 3, 8])
def test_settings_keep_their_order_whatever_lane_they_are_in(monkeypatch, told, lanes):
    monkeypatch.setattr(batches, "count_lanes", lambda: lanes)
    static = STATIC.grow(num_objects=65)
    answers, after = batches.run_batch(FRAMES, CONFIG, settings_of(7), static)
    assert after == static
    assert answers is not None
    expected = 100 * np.arange(7) + np.arange(20)[:, None]
    np.testing.assert_array_equal(answers.object_id[..., 0], expected)
    # Two or three settings side by side are filled up: LLVM cannot translate two.
    assert set(told) <= {1, 4, 7}


@pytest.mark.parametrize("lanes", [1, 2, 7])
def test_all_lanes_start_again_with_the_capacity_that_one_lacked(monkeypatch, told, lanes):
    monkeypatch.setattr(batches, "count_lanes", lambda: lanes)
    answers, after = batches.run_batch(FRAMES, CONFIG, settings_of(7), STATIC)
    assert answers is not None
    assert after.num_objects >= 65
    assert len(told) == 2
    np.testing.assert_array_equal(answers.needed_objects, np.zeros((20, 7)))


def test_a_lane_that_fails_ends_the_batch(monkeypatch, told):
    def fail(states, thresholds, part):
        raise RuntimeError("no room")

    program = types.SimpleNamespace(run=fail, num_bytes=0)
    monkeypatch.setattr(batches, "compile_follow", lambda *given: program)
    monkeypatch.setattr(batches, "count_lanes", lambda: 2)
    with pytest.raises(RuntimeError, match="no room"):
        batches.run_batch(FRAMES, CONFIG, settings_of(4), STATIC)


def test_the_lanes_of_a_batch_fit_into_memory_together(monkeypatch, told):
    monkeypatch.setattr(batches, "count_lanes", lambda: 2)
    batch, needed = batches.plan_batch(FRAMES, CONFIG, STATIC, 32, 1 << 30)
    assert (batch, needed) == (32, 3200)
