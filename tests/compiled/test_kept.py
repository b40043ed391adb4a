"""Programs on disk: found again, made anew where damaged, never in the way."""

from __future__ import annotations

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from remind_jax.compiled import kept
from remind_jax.errors import OutputError

from .counting import PAIR, Counted, files, run


@pytest.mark.parametrize("damage", ["empty", "noise", "half", "flipped"])
def test_a_damaged_file_is_made_anew(folder, damage, caplog):
    function = Counted()
    run(function)
    (path,) = files(folder)
    whole = path.read_bytes()
    flipped = bytes([*whole[:-40], whole[-40] ^ 1, *whole[-39:]])
    damaged = {"empty": b"", "noise": b"no program", "half": whole[: len(whole) // 2]}
    path.write_bytes(damaged.get(damage, flipped))
    np.testing.assert_array_equal(run(function)[1], [2, 2, 2])
    assert function.num_traces == 2
    run(function)
    assert function.num_traces == 2
    assert not caplog.records


def test_flipped_bytes_anywhere_are_found_before_the_library_sees_them(folder, monkeypatch):
    run(Counted())
    (path,) = files(folder)
    whole = path.read_bytes()

    def refuse(*args):
        raise AssertionError("damaged bytes reached the library")

    monkeypatch.setattr(kept.serialize_executable, "deserialize_and_load", refuse)
    places = {*range(0, 200), *range(200, len(whole) - 1, max(1, len(whole) // 200))}
    for place in sorted(places):
        flipped = bytearray(whole)
        flipped[place] ^= 0xFF
        flipped[place + 1] ^= 1
        path.write_bytes(flipped)
        assert kept.load(path) is None
        assert not path.exists()


@pytest.mark.parametrize("length", [0, 1, 31, 32, 33, 100, -1])
def test_a_file_that_was_cut_is_found(folder, length):
    run(Counted())
    (path,) = files(folder)
    path.write_bytes(path.read_bytes()[:length])
    assert kept.load(path) is None
    assert not path.exists()


def test_a_program_under_the_name_of_another_is_made_anew(folder):
    add, other = Counted(), Counted()
    run(add, key="add")
    (first,) = files(folder)
    run(other, pair=(PAIR[0][:2], PAIR[1][:2]), key="other")
    (second,) = set(files(folder)) - {first}
    one, two = first.read_bytes(), second.read_bytes()
    first.write_bytes(two)
    second.write_bytes(one)
    np.testing.assert_array_equal(run(add, key="add")[1], [2, 2, 2])
    np.testing.assert_array_equal(
        run(other, pair=(PAIR[0][:2], PAIR[1][:2]), key="other")[1], [2, 2]
    )
    assert (add.num_traces, other.num_traces) == (2, 2)
    run(add, key="add")
    assert (add.num_traces, other.num_traces) == (2, 2)


@pytest.mark.parametrize("is_empty", [True, False])
def test_a_folder_in_the_place_of_a_program_is_not_in_the_way(folder, is_empty):
    run(Counted())
    (path,) = files(folder)
    path.unlink()
    path.mkdir()
    if not is_empty:
        (path / "mine.txt").write_text("of somebody else")
    np.testing.assert_array_equal(run(Counted())[1], [2, 2, 2])
    assert path.is_file() == is_empty


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_a_pipe_in_the_place_of_a_program_is_removed(folder):
    run(Counted())
    (path,) = files(folder)
    path.unlink()
    os.mkfifo(path)
    np.testing.assert_array_equal(run(Counted())[1], [2, 2, 2])
    assert path.is_file()


def test_a_full_disk_costs_the_program_only(folder, monkeypatch):
    def fail(*args):
        raise OutputError("cannot write: No space left on device")

    monkeypatch.setattr(kept, "replace_file", fail)
    np.testing.assert_array_equal(run(Counted())[1], [2, 2, 2])
    assert not files(folder)


def test_programs_that_the_library_rejects_are_reported_once(folder, caplog, monkeypatch):
    function = Counted()
    run(function)

    def reject(*args):
        raise RuntimeError("feature +prefer-no-gather is not supported on this machine")

    monkeypatch.setattr(kept.serialize_executable, "deserialize_and_load", reject)
    for _ in range(3):
        np.testing.assert_array_equal(run(function)[1], [2, 2, 2])
    (record,) = caplog.records
    assert "+prefer-no-gather" in record.getMessage()
    assert f"{kept.VARIABLE}=off" in record.getMessage()


def test_a_folder_that_cannot_be_written_to_is_left_alone(folder):
    folder.write_text("a file where the folder should be")
    np.testing.assert_array_equal(run(Counted())[1], [2, 2, 2])


def test_keeping_can_be_switched_off(folder, monkeypatch):
    monkeypatch.setenv(kept.VARIABLE, "off")
    assert kept.program_folder() is None
    function = Counted()
    run(function)
    run(function)
    assert function.num_traces == 2
    assert not files(folder)


def test_what_comes_from_the_cache_of_jax_is_not_kept_again(folder, tmp_path):
    """Written a second time it would lack functions."""
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "of-jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    compilation_cache.reset_cache()
    run(Counted())
    (first,) = files(folder)
    first.unlink()
    np.testing.assert_array_equal(run(Counted())[1], [2, 2, 2])
    assert not files(folder)


def test_processors_and_versions_have_folders_of_their_own(folder, monkeypatch):
    monkeypatch.setattr(kept, "_processor", lambda: "another")
    assert kept.program_folder() not in (None, folder)
    assert jax.__version__ in folder.name


def test_the_folder_stays_within_its_bound(folder, monkeypatch):
    run(Counted(), key="old")
    (old,) = files(folder)
    os.utime(old, (1, 1))
    monkeypatch.setattr(kept, "_MOST_BYTES", old.stat().st_size * 3 // 2)
    run(Counted(), key="new")
    assert not old.exists()
    assert len(files(folder)) == 1


def test_a_program_that_calls_the_host_is_not_kept(folder):
    def ask_host(a, b):
        return jax.pure_callback(np.add, jax.ShapeDtypeStruct((3,), jnp.float32), a, b)

    np.testing.assert_array_equal(run(ask_host)[0], [2, 2, 2])
    assert not files(folder)


_CHOLESKY = """
import numpy as np
from remind_jax.compiled.programs import Recipe, get_program, shapes_of
import jax.numpy as jnp
square = np.eye(3, dtype=np.float32) * 4
recipe = Recipe("root", jnp.linalg.cholesky, shapes_of([square]), None)
print(float(get_program(recipe)(square)[0].sum()))
"""


def test_a_kept_program_may_call_lapack_in_a_process_that_never_lowered_such_a_call(folder):
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", _CHOLESKY],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "JAX_COMPILATION_CACHE_DIR": ""},
        )
        assert float(done.stdout) == 6.0
    assert len(files(folder)) == 1


_SUM = """
import sys
import jax.numpy as jnp, numpy as np
from remind_jax.compiled.programs import Recipe, get_program, shapes_of
before = "scipy.linalg" in sys.modules
row = np.ones(3, np.float32)
assert float(get_program(Recipe("sum", jnp.sum, shapes_of([row]), None))(row)[0]) == 3.0
print(before, "scipy.linalg" in sys.modules)
"""


def test_a_kept_program_without_lapack_does_not_wait_for_it(folder):
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", _SUM],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "JAX_COMPILATION_CACHE_DIR": ""},
        )
        assert done.stdout.split() == ["False", "False"]
    assert len(files(folder)) == 1
