"""Programs are kept in a folder of their own."""

import contextlib
from collections.abc import Iterator

import jax
import pytest
from jax.experimental.compilation_cache import compilation_cache

from remind_jax.compiled import kept
from remind_jax.compiled.programs import clear_programs


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
