"""What is installed is what was built: a wheel and a source archive, used from elsewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]


def call(*command: str | Path, cwd: Path, **environment: str) -> str:
    env = {**os.environ, **environment}
    env.pop("PYTEST_CURRENT_TEST", None)
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with the wheel, and the source archive that it was built from."""
    folder = tmp_path_factory.mktemp("dist")
    call(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT, cwd=folder)
    return folder


@pytest.fixture(scope="module")
def wheel(built) -> Path:
    (wheel,) = built.glob("*.whl")
    return wheel


def test_the_index_would_take_them(built):
    said = call(sys.executable, "-m", "twine", "check", "--strict", *built.iterdir(), cwd=built)
    assert said.count("PASSED") == 2


def test_the_wheel_holds_the_package_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        metadata = archive.read(next(n for n in names if n.endswith("/METADATA"))).decode()
    tops = {name.partition("/")[0] for name in names}
    assert tops == {"remind_jax", "weights_convert", wheel.name.split("-py3")[0] + ".dist-info"}
    here = {
        str(path.relative_to(ROOT))
        for folder in ("remind_jax", "weights_convert")
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    configs = {
        f"remind_jax/{path.relative_to(ROOT)}" for path in (ROOT / "configs").rglob("*.yaml")
    }
    assert {name for name in names if ".dist-info/" not in name} == here | configs
    assert re.search(r"^Requires-Python: .*>=3\.11", metadata, re.MULTILINE)


def test_the_source_archive_can_be_tested(built):
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    assert {"pyproject.toml", "LICENSE", "README.md", "tests/conftest.py", "Makefile"} <= names
    assert not [name for name in names if "__pycache__" in name or name.startswith(".venv")]


def write_pictures(folder: Path) -> None:
    """Four pictures with one patterned square, and its masks."""
    draw = np.random.default_rng(0)
    square = draw.integers(0, 255, (32, 32, 3), np.uint8)
    for name in ("images", "masks"):
        (folder / name).mkdir()
    for index in range(4):
        picture, mask = np.full((96, 128, 3), 90, np.uint8), np.zeros((96, 128), np.uint8)
        picture[20:52, 30 + index : 62 + index] = square
        mask[20:52, 30 + index : 62 + index] = 1
        cv2.imwrite(str(folder / "images" / f"{index}.png"), picture)
        cv2.imwrite(str(folder / "masks" / f"{index}.png"), mask)


def test_the_wheel_works_away_from_the_sources(wheel, tmp_path):
    site, work = tmp_path / "site", tmp_path / "work"
    work.mkdir()
    pip = (sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", site)
    call(*pip, wheel, cwd=work)
    path = {"PYTHONPATH": str(site)}
    place = "import remind_jax; print(remind_jax.__file__)"
    assert call(sys.executable, "-c", place, cwd=work, **path).startswith(str(site))
    command = (sys.executable, "-m", "remind_jax.cli.main")
    assert "published" in call(*command, "config", "list", cwd=work, **path)
    write_pictures(work)
    tour = ("images", "--masks", "masks", "--out", "out")
    said = call(*command, "run", *tour, "--quiet", "--json", cwd=work, **path)
    assert '"frames"' in said
    assert (work / "out" / "report.html").stat().st_size > 10_000


@pytest.mark.slow
def test_a_bare_environment_needs_two_commands(wheel, tmp_path):
    call(sys.executable, "-m", "venv", tmp_path / "env", cwd=tmp_path)
    python = tmp_path / "env" / "bin" / "python"
    call(python, "-m", "pip", "install", "--quiet", wheel, cwd=tmp_path)
    call(tmp_path / "env" / "bin" / "remind", "demo", cwd=tmp_path, PYTHONPATH="")
    first = (
        "import numpy as np, remind_jax as rj; "
        "image = np.random.default_rng(0).integers(0, 255, (96, 128, 3), np.uint8); "
        "masks = np.zeros((1, 96, 128), bool); masks[0, 16:80, 32:96] = True; "
        "print(rj.Tracker().update(image, masks).object_id[0])"
    )
    assert call(python, "-c", first, cwd=tmp_path, PYTHONPATH="").strip() == "0"
