"""Kept programs: traced once, found again only where nothing changed, never in the way."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.live import Tracker
from remind_jax.program_store import is_of_this_package, trace_once
from remind_jax.tracker import step
from tests.cli import scenes

CONFIG = {"static": {"num_detections": 4, "num_objects": 5, "num_pending": 4}}


@pytest.fixture
def folder(tmp_path):
    """A compilation cache of its own."""
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "remind-jax-programs"
    jax.config.update("jax_compilation_cache_dir", before)


class Counted:
    """A program that knows how often it was traced."""

    def __init__(self) -> None:
        self.num_traces = 0

    def __call__(self, pair: dict) -> dict:
        self.num_traces += 1
        return {"sum": pair["a"] + pair["b"], "is_less": pair["a"] < pair["b"]}


PAIR = {"a": np.arange(3, dtype=np.float32), "b": np.float32([2, 1, 0])}
LIKE = {"sum": 0, "is_less": 0}


def run(function, pair=PAIR, key=()):
    """As another process would: nothing of an earlier call is left."""
    return jax.jit(lambda pair: trace_once(function, (pair,), LIKE, key))(pair)


def test_a_program_is_traced_once(folder):
    function = Counted()
    first, second = run(function), run(function)
    assert function.num_traces == 1
    assert len(list(folder.iterdir())) == 1
    for told in (first, second):
        np.testing.assert_array_equal(told["sum"], [2, 2, 2])
        np.testing.assert_array_equal(told["is_less"], [True, False, False])


def test_another_key_or_shape_or_type_is_another_program(folder):
    function = Counted()
    run(function)
    run(function, key=("other",))
    run(function, {name: leaf[:2] for name, leaf in PAIR.items()})
    run(function, {name: leaf.astype(np.int32) for name, leaf in PAIR.items()})
    assert function.num_traces == len(list(folder.iterdir())) == 4


@pytest.mark.parametrize("damage", [b"", b"not a program", None])
def test_a_damaged_file_is_made_anew(folder, damage):
    function = Counted()
    run(function)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
    np.testing.assert_array_equal(run(function)["sum"], [2, 2, 2])
    assert function.num_traces == 2
    assert len(path.read_bytes()) == len(whole)


def test_a_folder_that_cannot_be_written_to_is_left_alone(folder):
    folder.write_text("a file where the folder should be")
    np.testing.assert_array_equal(run(Counted())["sum"], [2, 2, 2])


def test_without_a_cache_nothing_is_kept(folder):
    jax.config.update("jax_compilation_cache_dir", None)
    function = Counted()
    for _ in range(2):
        run(function)
    assert function.num_traces == 2
    assert not folder.exists()


def test_without_the_library_that_writes_programs_nothing_is_kept(folder, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    np.testing.assert_array_equal(run(Counted())["sum"], [2, 2, 2])
    assert not folder.exists()


def test_a_program_with_a_callback_is_traced_as_ever(folder):
    def ask_host(pair):
        shape = jax.ShapeDtypeStruct((3,), jnp.float32)
        total = jax.pure_callback(np.add, shape, pair["a"], pair["b"])
        return {"sum": total, "is_less": pair["a"] < pair["b"]}

    np.testing.assert_array_equal(run(ask_host)["sum"], [2, 2, 2])
    assert not folder.exists()


def test_only_functions_that_the_text_of_the_package_tells_are_kept():
    assert is_of_this_package(step)
    assert not is_of_this_package(np.add)
    assert not is_of_this_package(lambda state: state)
    assert not is_of_this_package(functools.partial(step))


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["jax", "host"])
def test_the_tracker_decides_the_same_with_kept_programs(folder, solver):
    def follow():
        tracker = Tracker({"base": "remind", "static": {**CONFIG["static"], "solver": solver}})
        return [tracker.update(*scenes.picture(index)) for index in range(3)]

    jax.config.update("jax_compilation_cache_dir", None)
    plain = follow()
    jax.config.update("jax_compilation_cache_dir", str(folder.parent))
    jax.clear_caches()
    kept = follow()
    for one, other in zip(plain, kept, strict=True):
        np.testing.assert_array_equal(one.object_id, other.object_id)
        np.testing.assert_array_equal(one.score, other.score)
    assert folder.exists() == (solver == "jax")
