"""Where files that can be obtained again are kept."""

from __future__ import annotations

from pathlib import Path

import pytest

from remind_jax import files as user_folders
from remind_jax.files import user_cache_folder


@pytest.mark.parametrize(
    ("system", "variable", "expected"),
    [
        ("linux", "XDG_CACHE_HOME", "remind-jax"),
        ("win32", "LOCALAPPDATA", "remind-jax"),
    ],
)
def test_cache_folder_follows_the_system(monkeypatch, tmp_path, system, variable, expected):
    monkeypatch.setattr(user_folders.sys, "platform", system)
    monkeypatch.setenv(variable, str(tmp_path))
    assert user_cache_folder() == tmp_path / expected


def test_cache_folder_below_the_home_folder(monkeypatch):
    monkeypatch.setattr(user_folders.sys, "platform", "darwin")
    assert user_cache_folder() == Path.home() / "Library" / "Caches" / "remind-jax"
