"""One folder with a tiny scene, and the command as a function."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from remind_jax.cli.main import main
from tests.cli import scenes
from tests.compiled.conftest import folder  # noqa: F401  (of programs)
from tests.outputs.fake_run import make_run


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    code: int
    stdout: str
    stderr: str


@pytest.fixture
def command(capfd, monkeypatch, tmp_path) -> Callable[..., Outcome]:
    """Runs `remind ...` in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> Outcome:
        capfd.readouterr()
        return Outcome(main([*map(str, words)]), *capfd.readouterr())

    return run


@pytest.fixture(scope="session")
def saved_run(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("saved") / "run"
    make_run()[1].save(path)
    return path


@pytest.fixture
def run(saved_run, tmp_path) -> Path:
    """The folder of a made-up run."""
    return shutil.copytree(saved_run, tmp_path / "run")


@pytest.fixture
def scene(tmp_path) -> tuple[Path, Path]:
    """Folders of images and masks of four frames."""
    return scenes.write_scene(tmp_path / "scene")
