"""The live tracker: one compilation, growth, and a memory that survives an interruption."""

from __future__ import annotations

import dataclasses
import functools

import jax
import numpy as np
import pytest

from remind_jax import live
from remind_jax.compiled_step import step_packed
from remind_jax.errors import SourceError
from remind_jax.frame import Frame
from remind_jax.live import Tracker
from tests.cli import scenes

CONFIG = {"static": {"num_detections": 4, "num_objects": 6, "num_pending": 4}}


def frames(num: int) -> list[tuple[np.ndarray, np.ndarray]]:
    return [scenes.picture(index) for index in range(num)]


@pytest.mark.slow
def test_one_compilation_whatever_the_counts():
    num_traces = 0

    def count_and_step(*args, **kwargs):
        nonlocal num_traces
        num_traces += 1
        return step(*args, **kwargs)

    # A capacity that no other test uses: nothing is compiled yet.
    tracker = Tracker({"static": {**CONFIG["static"], "num_objects": 13}})
    step = tracker.method.step
    tracker.method = dataclasses.replace(tracker.method, step=count_and_step)
    for index, ids in enumerate([(1, 2, 3), (1, 2, 3), (1,), (), (1, 2, 3, 4)]):
        tracker.update(*scenes.picture(index, ids))
    assert num_traces == 1


def test_step_gives_the_types_that_it_takes(monkeypatch):
    """A weak type that comes or goes would be a second compilation, in the second frame."""
    tracker = Tracker(CONFIG)
    taken = []

    def look(state, *args, **options):
        given, *_ = jax.eval_shape(functools.partial(step_packed, **options), state, *args)
        taken.append(jax.typeof(leaf) for leaf in jax.tree.leaves(state))
        taken.append(jax.typeof(leaf) for leaf in jax.tree.leaves(given))
        raise KeyboardInterrupt

    monkeypatch.setattr(live, "compiled_step", lambda: look)
    with pytest.raises(KeyboardInterrupt):
        tracker.update(*frames(1)[0])
    before, after = (
        [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in leaves] for leaves in taken
    )
    assert before == after


def test_interruption_while_the_step_is_waited_for_leaves_the_memory_whole(monkeypatch, tmp_path):
    tracker = Tracker(CONFIG)
    first, second, third = frames(3)
    tracker.update(*first)

    def interrupt(tree):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(live.jax, "device_get", interrupt)
        with pytest.raises(KeyboardInterrupt):
            tracker.update(*second)
    tracker.save(tmp_path / "memory.safetensors")
    other = Tracker(CONFIG)
    other.load(tmp_path / "memory.safetensors")
    assert int(other.state.frame) == int(tracker.state.frame) == 2
    told, expected = other.update(*third), tracker.update(*third)
    np.testing.assert_array_equal(told.object_id, expected.object_id)
    assert set(told.object_id) == {0, 1, 2}


def test_features_of_another_width_are_refused():
    tracker = Tracker(CONFIG)
    image, labels = frames(1)[0]
    tracker.update(image, labels)
    grid = (scenes.HEIGHT_PX // scenes.PATCH_PX, scenes.WIDTH_PX // scenes.PATCH_PX)
    frame = Frame(1, 1, 1.0, "1", image, features=np.zeros((*grid, 7), np.float32))
    with pytest.raises(SourceError, match=r"features of 7 numbers.*the memory knows"):
        tracker.update(frame, labels)
