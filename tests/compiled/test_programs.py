"""Programs: compiled once, found again only where nothing changed, never in the way."""

from __future__ import annotations

import contextlib
import functools
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from remind_jax.compiled import kept
from remind_jax.compiled.frame_step import ONE_FRAME_OPTIONS
from remind_jax.compiled.programs import (
    KeptFunction,
    Recipe,
    clear_programs,
    get_program,
    is_of_this_package,
    known_options,
    shapes_of,
    waited_s,
)
from remind_jax.remind.tracker import step

PAIR = (np.arange(3, dtype=np.float32), np.array([2, 1, 0], np.float32))


@contextlib.contextmanager
def without_cache_of_jax() -> Iterator[None]:
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: jax.config.values[name] for name in names}
    jax.config.update("jax_compilation_cache_dir", None)
    compilation_cache.reset_cache()
    yield
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Programs are kept in a folder of their own."""
    monkeypatch.setenv(kept.VARIABLE, str(tmp_path))
    clear_programs()
    with without_cache_of_jax():
        yield kept.program_folder()
    clear_programs()


class Counted:
    """A function that knows how often it was traced."""

    def __init__(self) -> None:
        self.num_traces = 0

    def __call__(self, a: jax.Array, b: jax.Array) -> dict:
        self.num_traces += 1
        return {"is_less": a < b, "sum": a + b}


def run(function, pair=PAIR, key="counted", **options):
    """As another process would: nothing of an earlier call is left in this one."""
    clear_programs()
    program = get_program(Recipe("sum", function, shapes_of(pair), key, **options))
    return program(*pair)


def files(folder: Path) -> list[Path]:
    return list(folder.iterdir()) if folder.exists() else []


def test_a_program_is_compiled_once_for_all_processes(folder):
    function = Counted()
    first, second = run(function), run(function)
    assert function.num_traces == len(files(folder)) == 1
    for is_less, total in (first, second):
        np.testing.assert_array_equal(total, [2, 2, 2])
        np.testing.assert_array_equal(is_less, [True, False, False])


def test_a_program_is_compiled_once_for_all_threads(folder):
    function = Counted()
    recipe = Recipe("sum", function, shapes_of(PAIR), "threads", is_kept=False)
    threads = [threading.Thread(target=get_program, args=(recipe,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert function.num_traces == 1


def test_who_waits_learns_how_long(folder):
    before = waited_s()
    run(Counted())
    assert waited_s() > before


def test_a_failure_is_reported_and_not_kept(folder):
    def fail(a, b):
        raise ValueError("no such thing")

    with pytest.raises(ValueError, match="no such thing"):
        run(fail)
    assert run(Counted())


def test_another_key_or_shape_or_type_is_another_program(folder):
    function = Counted()
    run(function)
    run(function, key="other")
    run(function, tuple(leaf[:2] for leaf in PAIR))
    run(function, tuple(leaf.astype(np.int32) for leaf in PAIR))
    assert function.num_traces == len(files(folder)) == 4


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


def test_options_that_the_compiler_does_not_know_are_left_out():
    options = tuple(ONE_FRAME_OPTIONS["cpu"].items())
    assert known_options(()) is None
    assert known_options(options) == dict(options)
    lost = ("xla_cpu_no_such_option", True)
    assert known_options((*options, lost)) == dict(options)
    assert known_options((lost,)) is None


def test_a_kept_function_is_itself_under_jit(folder):
    double = KeptFunction("double", lambda x: 2 * x, None)
    np.testing.assert_array_equal(double(PAIR[0]), [0, 2, 4])
    np.testing.assert_array_equal(jax.jit(lambda x: double(x) + 1)(PAIR[0]), [1, 3, 5])
    assert len(files(folder)) == 1


def test_only_functions_that_the_text_of_the_package_shows_are_kept():
    assert is_of_this_package(step)
    assert not is_of_this_package(np.add)
    assert not is_of_this_package(lambda state: state)
    assert not is_of_this_package(functools.partial(step))


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
        outcome = subprocess.run(
            [sys.executable, "-c", _CHOLESKY],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "JAX_COMPILATION_CACHE_DIR": ""},
        )
        assert float(outcome.stdout) == 6.0
    assert len(files(folder)) == 1
