"""Configuration files: those that are shipped, and YAML as plain nested values."""

from __future__ import annotations

import functools
import itertools
from pathlib import Path
from typing import Any

from remind_jax.errors import ConfigError, nearest_names
from remind_jax.files import as_path, records
from remind_jax.method import PAPER_METHOD, list_methods

_SUFFIXES = (".yaml", ".yml")


def list_configs() -> list[str]:
    """Names of the shipped configurations."""
    return sorted(file.stem for file in shipped_folder().glob("*.yaml"))


def find_file(name: str | Path) -> Path:
    """File of a configuration by name or path. Raises ConfigError if it can be none."""
    path = as_path(name, "the configuration", ConfigError)
    if path.suffix in _SUFFIXES:
        return path
    shipped = list_configs()
    if str(name) in shipped:
        return shipped_folder() / f"{name}.yaml"
    if path.exists():
        raise ConfigError(f"'{name}' is no configuration; give a {' or '.join(_SUFFIXES)} file")
    if str(name) in list_methods():
        raise ConfigError(
            f"{str(name)!r} is a tracker and no configuration; choose it by --tracker, or give "
            f"{{'tracker': {str(name)!r}}}"
        )
    hint = nearest_names(str(name), shipped)
    raise ConfigError(f"there is no configuration {str(name)!r}; {hint} (or give a .yaml file)")


def beside(file: Path, base: str | Path) -> str | Path:
    """What a file starts from: the file of that name in its folder, if there is one."""
    there = file.parent / base
    return there if there.suffix in _SUFFIXES and there.is_file() else base


def find_profile(tracker: str, backbone: str) -> Path | None:
    """The file of thresholds of a tracker made for a backbone; None where none is shipped."""
    folder = shipped_folder() / "backbones"
    if tracker != PAPER_METHOD:
        folder /= tracker.replace("-", "_")
    path = folder / f"{backbone.replace('-', '_')}.yaml"
    return path if path.is_file() else None


def describe_config(name: str) -> str:
    """What a shipped configuration is: the first sentence of the comment that its file begins with.

    Raises:
      ConfigError: If there is no such configuration.
    """
    lines = find_file(name).read_text(encoding="utf-8").splitlines()
    comment = itertools.takewhile(lambda line: line.startswith("#"), lines)
    words = " ".join(line.lstrip("# ") for line in comment)
    return words.partition(". ")[0].rstrip(".")


def read_yaml(path: Path) -> dict[str, Any]:
    """Reads a mapping from a YAML file. Raises ConfigError if it is missing or holds none."""
    return records.read_yaml(path, dict[str, Any], refused=ConfigError)


@functools.cache
def shipped_folder() -> Path:
    """The folder of shipped files: inside the wheel, or beside the package in a checkout."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"
