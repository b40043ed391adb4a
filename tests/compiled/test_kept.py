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

from .counting import Counted, files, run


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
from remind_jax.compiled.frame_step import ONE_FRAME_OPTIONS
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
