"""Programs on disk: found again, made anew where damaged, never in the way."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from remind_jax.compiled import kept
from remind_jax.errors import OutputError

from .counting import PAIR, Counted, files, run


def test_damage_anywhere_is_found_before_the_library_sees_it(folder, monkeypatch):
    run(Counted())
    (path,) = files(folder)
    whole = path.read_bytes()

    def refuse(*args):
        raise AssertionError("damaged bytes reached the library")

    monkeypatch.setattr(kept.serialize_executable, "deserialize_and_load", refuse)
    damaged = [whole[:length] for length in (0, 1, 31, 32, 33, 100, -1)]
    for place in (*range(0, 200), *range(200, len(whole) - 1, max(1, len(whole) // 200))):
        flipped = bytearray(whole)
        flipped[place] ^= 0xFF
        damaged.append(bytes(flipped))
    for content in damaged:
        path.write_bytes(content)
        assert kept.load(path) is None
        assert not path.exists()


def test_a_program_under_the_name_of_another_is_made_anew(folder):
    add, other, short = Counted(), Counted(), (PAIR[0][:2], PAIR[1][:2])
    run(add, key="add")
    (first,) = files(folder)
    run(other, pair=short, key="other")
    (second,) = set(files(folder)) - {first}
    one, two = first.read_bytes(), second.read_bytes()
    first.write_bytes(two)
    second.write_bytes(one)
    for _ in range(2):
        np.testing.assert_array_equal(run(add, key="add")[1], [2, 2, 2])
        np.testing.assert_array_equal(run(other, pair=short, key="other")[1], [2, 2])
        assert (add.num_traces, other.num_traces) == (2, 2)


def test_what_lies_in_the_place_of_a_program_is_not_in_the_way(folder, caplog):
    run(Counted())
    (path,) = files(folder)
    for make in (Path.mkdir, os.mkfifo, lambda path: path.write_bytes(b"no program")):
        path.unlink()
        make(path)
        for num_traces in (1, 0):  # made anew, and kept again
            function = Counted()
            np.testing.assert_array_equal(run(function)[1], [2, 2, 2])
            assert function.num_traces == num_traces
    assert not caplog.records
    path.unlink()
    path.mkdir()
    (path / "mine.txt").write_text("of somebody else")
    np.testing.assert_array_equal(run(Counted())[1], [2, 2, 2])
    assert (path / "mine.txt").exists()


def test_a_full_disk_costs_the_program_only(folder, monkeypatch):
    def fail(*args):
        raise OutputError("cannot write: No space left on device")

    monkeypatch.setattr(kept, "write_sealed", fail)
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


_PROGRAM = """
import sys
import jax.numpy as jnp, numpy as np
from remind_jax.compiled.programs import Recipe, get_program, shapes_of
square, function = np.eye(3, dtype=np.float32) * 4, eval(sys.argv[1])
result = get_program(Recipe("of a test", function, shapes_of([square]), None))(square)
print(float(result[0].sum()), "scipy.linalg" in sys.modules)
"""


SEVERAL = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}


@pytest.mark.parametrize(
    ("function", "environment", "said"),
    [
        # Such a call needs what is registered when one is lowered; others must not wait for it.
        ("jnp.linalg.cholesky", {}, "6.0 True"),
        ("jnp.sum", {}, "12.0 False"),
        ("jnp.sum", SEVERAL, "12.0 False"),
    ],
    ids=["calls LAPACK", "does not", "several devices"],
)
def test_a_kept_program_runs_in_a_process_that_never_made_one(folder, function, environment, said):
    for _ in range(2):  # made, and found again
        done = subprocess.run(
            [sys.executable, "-c", _PROGRAM, function],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, **environment, "JAX_COMPILATION_CACHE_DIR": ""},
        )
        assert done.stdout.strip() == said
    assert len(files(folder)) == 1
