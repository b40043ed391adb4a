"""How cores of a CPU share a batch, with a program that says what it was given."""

import types

import numpy as np
import pytest

from remind_jax.config import load_config
from remind_jax.method import get_method
from remind_jax.sweeps import batches
from remind_jax.sweeps.program import Answers
from tests.sweeps.tiny_sweep import CONFIG

FRAMES = {"number": np.arange(20)}  # two calls of the program
STATIC = CONFIG.static
CONFIGS = {"published": CONFIG, "default": load_config()}
PAPER, PLUS = get_method(CONFIG.tracker), get_method("plus")
NAMES = {"published": "matching.match", "default": "memory.novel"}


def settings_of(number, tracker="published"):
    return [{NAMES[tracker]: 0.001 * index} for index in range(number)]


@pytest.fixture
def told(monkeypatch):
    """Sizes of the programs that were asked for; the setting 0.004 lacks slots up to 64 objects."""
    sizes = []

    def compile_follow(method, static, num, thresholds, frames):
        sizes.append(num)

        def run(states, thresholds, part):
            is_paper = method is PAPER
            value = thresholds.matching.match if is_paper else thresholds.memory.novel
            said = np.rint(1000 * np.asarray(value)).astype(int)
            said = np.broadcast_to(said, (len(part["number"]), num))
            lacking = 65 * ((said == 4) & (static.num_objects < 65))
            ids = 100 * said + np.asarray(part["number"])[:, None]
            one = ids[..., None]
            return states, Answers(one, one, one, {}, lacking, 0 * ids)

        return types.SimpleNamespace(run=run, num_bytes=100 * num)

    monkeypatch.setattr(batches, "compile_follow", compile_follow)
    monkeypatch.setattr(batches, "empty_memories", lambda *given: np.zeros(1))
    return sizes


@pytest.mark.parametrize(("cores", "size"), [(1, 9), (2, 5), (3, 4), (8, 4), (9, 1)])
def test_cores_share_a_batch(monkeypatch, cores, size):
    monkeypatch.setattr(batches, "count_cores", lambda: cores)
    assert batches.program_size(PAPER, 9) == size
    assert batches.program_size(PLUS, 9) == 1


@pytest.mark.parametrize("tracker", ["published", "default"])
@pytest.mark.parametrize("cores", [1, 2, 3, 8])
def test_settings_keep_their_order_whatever_core_they_are_on(monkeypatch, told, cores, tracker):
    monkeypatch.setattr(batches, "count_cores", lambda: cores)
    config, settings = CONFIGS[tracker], settings_of(7, tracker)
    static = STATIC.grow(num_objects=65)
    answers, after = batches.run_batch(FRAMES, config, settings, static)
    assert after == static
    assert answers is not None
    expected = 100 * np.arange(7) + np.arange(20)[:, None]
    np.testing.assert_array_equal(answers.object_id[..., 0], expected)
    # Two or three settings side by side are filled up: LLVM cannot translate two.
    assert set(told) <= ({1, 4, 7} if tracker == "published" else {1})


@pytest.mark.parametrize("cores", [1, 2, 7])
def test_who_lacks_capacity_starts_again(monkeypatch, told, cores):
    """Capacities that one setting lacked are those of all that start after it."""
    monkeypatch.setattr(batches, "count_cores", lambda: cores)
    answers, after = batches.run_batch(FRAMES, CONFIG, settings_of(7), STATIC)
    assert answers is not None
    assert after.num_objects >= 65
    assert len(told) == -(-7 // batches.program_size(PAPER, 7)) + 1
    np.testing.assert_array_equal(answers.needed_objects, np.zeros((20, 7)))


def test_what_is_left_goes_through_the_program_of_a_full_batch(monkeypatch, told):
    monkeypatch.setattr(batches, "count_cores", lambda: 2)
    answers, _ = batches.run_batch(FRAMES, CONFIG, settings_of(3), STATIC, 16)
    assert told == [8]
    assert answers is not None
    np.testing.assert_array_equal(answers.object_id[0, :, 0], [0, 100, 200])


def test_a_core_that_fails_ends_the_batch(monkeypatch, told):
    def fail(states, thresholds, part):
        raise RuntimeError("no room")

    program = types.SimpleNamespace(run=fail, num_bytes=0)
    monkeypatch.setattr(batches, "compile_follow", lambda *given: program)
    monkeypatch.setattr(batches, "count_cores", lambda: 2)
    with pytest.raises(RuntimeError, match="no room"):
        batches.run_batch(FRAMES, CONFIG, settings_of(4), STATIC)


def test_the_programs_of_a_batch_fit_into_memory_together(monkeypatch, told):
    monkeypatch.setattr(batches, "count_cores", lambda: 2)
    batch, needed = batches.plan_batch(FRAMES, CONFIG, STATIC, 32, 1 << 30)
    assert (batch, needed) == (32, 3200)
