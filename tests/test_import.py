"""What importing costs, and which way dependencies point."""

import importlib
import sys
from pathlib import Path

import pytest

import remind_jax
from tests.cli.test_streams import run_python
from tests.test_dependencies import imported_by

PACKAGE = Path(remind_jax.__file__).parent

# Extras, and what is too slow to load before it is needed.
LATE = ("jax", "torch", "matplotlib", "onnxruntime", "supervision", "pandas")
BUDGET_S = 2.0

# Rooms of pure functions over arrays.
PURE = (
    "remind",
    "plus",
    "baselines",
    "solvers",
    "numerics",
    "decision",
    "observation",
    "method",
    "static",
    "errors",
)
ALLOWED = {"remind_jax", "jax", "numpy", "scipy", "jaxtyping", *sys.stdlib_module_names}
# What observes frames ahead of the step, or looks into what is at rest.
ON_THE_HOST = ("plus/image_light.py", "plus/image_motion.py", "plus/one_thread.py")


def test_import_is_quick_and_loads_nothing_heavy_nor_does_what_runs_need_an_extra():
    finished = run_python(
        f"""
        import sys, time
        start = time.process_time()
        import remind_jax
        spent_s = time.process_time() - start
        print(spent_s, *[name for name in {LATE} if name in sys.modules])
        remind_jax.run, remind_jax.Tracker
        print("with", *[name for name in {LATE[1:]} if name in sys.modules])
        """
    )
    imported, ready = finished.stdout.splitlines()
    spent_s, *loaded = imported.split()
    assert (loaded, ready) == ([], "with")
    assert float(spent_s) < BUDGET_S


def level_after_import(module: str, **variables: str) -> str:
    """What the compiler's library will read when it is loaded."""
    code = f"""
        import os, sys, {module}
        assert 'jaxlib' not in sys.modules
        print(os.environ.get('TF_CPP_MIN_LOG_LEVEL'))
    """
    return run_python(code, **variables).stdout.strip()


def test_alarms_of_the_compiler_are_off_unless_asked_for():
    command = "remind_jax.cli.main"
    assert level_after_import(command) == "3"
    assert level_after_import(command, TF_CPP_MIN_LOG_LEVEL="0") == "0"
    assert level_after_import("remind_jax") == "None"  # a library leaves the environment alone


@pytest.mark.slow
@pytest.mark.parametrize(("level", "is_told"), [(None, False), ("0", True)])
def test_a_slow_compilation_alarms_nobody(level, is_told):
    """Folding this constant takes seconds, which the compiler complains about after one."""
    code = """
        import remind_jax.cli.main, jax, jax.numpy as jnp
        def fold():
            ones = jnp.ones((400, 400))
            return jax.lax.reduce_window(ones, 0.0, jax.lax.add, (5, 5), (1, 1), "SAME").sum()
        jax.jit(fold).lower().compile()
    """
    chosen = {"JAX_ENABLE_COMPILATION_CACHE": "false"}  # else it may have been compiled before
    chosen |= {} if level is None else {"TF_CPP_MIN_LOG_LEVEL": level}
    finished = run_python(code, **chosen)
    assert finished.returncode == 0
    assert ("file a bug" in finished.stderr) == is_told


def test_every_public_name_is_there():
    for name in remind_jax.__all__:
        assert getattr(remind_jax, name).__name__.rpartition(".")[2] == name


def test_no_module_hides_a_public_name():
    """Importing `remind_jax.NAME` puts the module in the place of what NAME stands for."""
    modules = {path.stem for path in PACKAGE.iterdir()} & set(remind_jax.__all__)
    for name in modules:
        public = getattr(remind_jax, name)
        importlib.import_module(f"remind_jax.{name}")
        assert getattr(remind_jax, name) is public


@pytest.mark.parametrize("room", PURE)
def test_what_runs_on_the_device_imports_arrays_only(room):
    """Which rooms may import which is a contract in `pyproject.toml`; this is about packages."""
    paths = sorted((PACKAGE / room).rglob("*.py")) or [PACKAGE / f"{room}.py"]
    assert paths[0].exists()
    for path in paths:
        if path.relative_to(PACKAGE).as_posix() not in ON_THE_HOST:
            tops = imported_by(path)
            assert tops <= ALLOWED, f"{path} imports {tops - ALLOWED}"
