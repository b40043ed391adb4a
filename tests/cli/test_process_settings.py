"""What the command line sets for its process."""

from __future__ import annotations

import jax
import pytest

from remind_jax.cli import process_settings
from remind_jax.cli.process_settings import keep_compiled_programs


@pytest.fixture
def cache_setting():
    """Puts JAX's settings back."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    yield lambda: getattr(jax.config, names[0])
    for name, value in before.items():
        jax.config.update(name, value)


def test_programs_are_kept_in_the_cache_folder_of_the_user(monkeypatch, tmp_path, cache_setting):
    monkeypatch.delenv(process_settings.CACHE_VARIABLE, raising=False)
    monkeypatch.setattr(process_settings, "user_cache_folder", lambda: tmp_path / "cache")
    keep_compiled_programs()
    assert cache_setting() == str(tmp_path / "cache" / "compiled")
    assert (tmp_path / "cache" / "compiled").is_dir()


def test_the_variable_of_jax_decides(monkeypatch, tmp_path, cache_setting):
    before = cache_setting()
    monkeypatch.setenv(process_settings.CACHE_VARIABLE, str(tmp_path))
    keep_compiled_programs()
    assert cache_setting() == before


def test_a_cache_that_cannot_be_made_is_no_error(monkeypatch, tmp_path, cache_setting):
    (tmp_path / "file").write_text("")
    before = cache_setting()
    monkeypatch.delenv(process_settings.CACHE_VARIABLE, raising=False)
    monkeypatch.setattr(process_settings, "user_cache_folder", lambda: tmp_path / "file")
    keep_compiled_programs()
    assert cache_setting() == before
