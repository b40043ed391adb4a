"""`Config`: static structure, thresholds and input options, read from strict YAML.

A file holds any part of the tree `input`, `static`, `thresholds`; what it leaves out keeps the
published value. `base: NAME` starts from another configuration or file, `tracker: NAME` chooses
the method whose thresholds these are.
"""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from remind_jax.config.dotted_keys import flatten, nest
from remind_jax.config.static import Static
from remind_jax.config.thresholds import Thresholds
from remind_jax.config.validation import check_fields
from remind_jax.errors import ConfigError, nearest_names
from remind_jax.methods import PAPER_METHOD, get_method


@dataclasses.dataclass(frozen=True)
class Input:
    """How frames and masks are prepared on the host (perception notes 1, 6.1)."""

    max_width_px: int = 1280  # wider frames are reduced to this width
    center_crop: bool = True  # crop to whole patches around the centre, else at the top left
    # Detections of these classes are left out.
    ignored_classes: tuple[str, ...] = ("wall", "floor", "ceiling", "object")
    # How a mask is filled before its surroundings are described.
    sanitize: typing.Literal["convex_hull", "morphology", "none"] = "convex_hull"
    keep_largest: bool = False  # look at the background around the largest piece of a mask only
    fill_holes: bool = True  # "morphology": fill holes
    close_px: int = 3  # "morphology": side of the closing square
    open_px: int = 0  # "morphology": side of the opening square, 0: none
    erosion_px: int = 0  # masks lose so many pixels on every side first
    # Detections after which an object gets its id. 0: 1 for given masks, 5 for a detector.
    announce_after: int = 0

    def __post_init__(self) -> None:
        check_fields(
            self, "input", may_be_zero=("close_px", "open_px", "erosion_px", "announce_after")
        )


@dataclasses.dataclass(frozen=True)
class Config:
    """Everything that a run can be told, apart from its input and its backbone."""

    tracker: str = PAPER_METHOD  # name of the method, see `remind_jax.methods`
    input: Input = dataclasses.field(default_factory=Input)
    static: Static = dataclasses.field(default_factory=Static)
    # Those of REMIND; other trackers have their own.
    thresholds: Thresholds | Any = dataclasses.field(default_factory=Thresholds)
    backbone_profile: bool = False  # what nobody changed follows configs/backbones/NAME.yaml

    def to_dict(self) -> dict[str, Any]:
        """Plain nested values, fit for YAML and JSON."""
        return _plain(dataclasses.asdict(self))

    def updated(self, changes: Mapping[str, Any], origin: str = "changes") -> Config:
        """A copy with some values changed, e.g. `{"thresholds": {"matching": {"match": 0.7}}}`.

        Raises:
          ConfigError: For an unknown key or a value of the wrong kind.
        """
        changes = dict(changes)
        start = self.with_tracker(changes.pop("tracker", self.tracker))
        return _update(start, changes, (), origin)

    def with_tracker(self, name: str) -> Config:
        """The configuration for another tracker; input and static stay.

        Thresholds are those of the shipped configuration of that name, where there is one, else
        the published ones of the tracker.

        Raises:
          ConfigError: If there is no such tracker.
        """
        if name == self.tracker:
            return self
        get_method(name)
        start = load_config(name) if name in list_configs() else _neutral(name)
        return dataclasses.replace(self, tracker=name, thresholds=start.thresholds)

    def difference(self, other: Config) -> list[tuple[str, Any, Any]]:
        """Keys whose values differ, with this value and the other's (None: it has no such key)."""
        mine, theirs = dict(flatten(self.to_dict())), dict(flatten(other.to_dict()))
        return [(key, mine[key], theirs.get(key)) for key in mine if mine[key] != theirs.get(key)]

    def for_backbone(self, name: str) -> Config:
        """The configuration with the profile of a backbone, where one is shipped and wanted.

        Published thresholds belong to the features that they were tuned on. A profile replaces
        those that still have their published value.
        """
        folder = _shipped_folder() / "backbones"
        if self.tracker != PAPER_METHOD:
            folder /= self.tracker.replace("-", "_")
        path = folder / f"{name.replace('-', '_')}.yaml"
        if not self.backbone_profile or not path.is_file():
            return self
        mine = dict(flatten(self.to_dict()))
        published = dict(flatten(_neutral(self.tracker).to_dict()))
        profile = dict(flatten(read_yaml(path)))
        changes = {key: profile[key] for key in profile if mine.get(key) == published.get(key)}
        return self.updated(nest(changes), str(path))

    @classmethod
    def from_reference(cls, settings: Mapping[str, Any] | str | Path) -> Config:
        """Reads settings written for the original implementation.

        Args:
          settings: Nested keys as in the original's YAML, or the path of such a file; what is
            left out keeps the published value.

        Raises:
          ConfigError: For a key that the original does not have, or a value that is not supported.
        """
        from remind_jax.config.reference_keys import translate

        if not isinstance(settings, Mapping):
            settings = read_yaml(Path(settings))
        changes = translate(settings, cls().to_dict())
        return cls().updated(changes, "settings of the original")


def load_config(name: str | Path | Config | Mapping[str, Any] = "default") -> Config:
    """Gives a configuration by name, by file, or from nested values.

    Args:
      name: Name of a shipped configuration, path of a YAML file, nested values on top of their
        `base` (`default` if they name none), or a `Config` that is returned as it is.

    Raises:
      ConfigError: If there is no such configuration or it holds an unknown key or a wrong value.
    """
    return name if isinstance(name, Config) else _load(name, ())


def _load(name: str | Path | Mapping[str, Any], opened: tuple[str, ...]) -> Config:
    """Reads a configuration; `opened` are the files that start from it, one from the next."""
    if isinstance(name, Mapping):
        origin, values = "changes", {"base": "default", **name}
    else:
        path = _find(name)
        origin, values = str(path), read_yaml(path)
        if origin in opened:
            circle = " -> ".join((*opened[opened.index(origin) :], origin))
            raise ConfigError(f"configurations start from each other in a circle: {circle}")
        opened = (*opened, origin)
    base = values.pop("base", None)
    if base is None:
        return _neutral(values.pop("tracker", PAPER_METHOD)).updated(values, origin)
    if not isinstance(base, (str, Path)):
        raise ConfigError(
            f"base in {origin} is {base!r}; it must be the name of a configuration or a .yaml file"
        )
    return _load(base, opened).updated(values, origin)


def _find(name: str | Path) -> Path:
    """The file of a configuration by name or path."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml"):
        return path
    shipped = {file.stem: file for file in sorted(_shipped_folder().glob("*.yaml"))}
    if str(name) not in shipped:
        hint = nearest_names(str(name), shipped)
        raise ConfigError(f"there is no configuration {str(name)!r}; {hint} (or give a .yaml file)")
    return shipped[str(name)]


def _neutral(tracker: str) -> Config:
    """A tracker with everything as published."""
    return Config(tracker=tracker, thresholds=get_method(tracker).thresholds())


def list_configs() -> list[str]:
    """Names of the shipped configurations."""
    return sorted(file.stem for file in _shipped_folder().glob("*.yaml"))


def read_yaml(path: Path) -> dict[str, Any]:
    """Reads a mapping from a YAML file.

    Raises:
      ConfigError: If the file is missing, is no YAML or holds something else than a mapping.
    """
    import yaml  # the core needs no YAML

    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read configuration {path}: {error.strerror}") from error
    except yaml.YAMLError as error:
        reason = str(error).replace("\n", " ")
        raise ConfigError(f"{path} is not valid YAML: {reason}") from error
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigError(f"{path} must hold keys and values, not a {type(values).__name__}")
    return values


@functools.cache
def _shipped_folder() -> Path:
    """The folder of shipped files: inside the wheel, or beside the package in a checkout."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    return value.item() if hasattr(value, "item") else value


def _update(node: Any, changes: Mapping[str, Any], path: tuple[str, ...], origin: str) -> Any:
    """Replaces fields of nested dataclasses, checking names and kinds."""
    fields = {field.name: field for field in dataclasses.fields(node)}
    updated = {}
    for key, value in changes.items():
        dotted = ".".join((*path, str(key)))
        if key not in fields:
            hint = nearest_names(str(key), fields)
            raise ConfigError(f"unknown key {dotted!r} in {origin}; {hint}")
        old = getattr(node, key)
        if dataclasses.is_dataclass(old):
            if not isinstance(value, Mapping):
                raise ConfigError(
                    f"{dotted} in {origin} is {value!r}; it must hold keys and values"
                )
            updated[key] = _update(old, value, (*path, str(key)), origin)
        else:
            updated[key] = _coerce(value, old, dotted, origin)
    return dataclasses.replace(node, **updated)


def _coerce(value: Any, old: Any, dotted: str, origin: str) -> Any:
    """The value in the kind of the one that it replaces; arrays pass, they are sweeps."""
    wanted = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
    if isinstance(old, bool):
        fits = isinstance(value, bool)
    elif isinstance(old, int):
        fits = isinstance(value, int) and not isinstance(value, bool)
    elif isinstance(old, float):
        fits = isinstance(value, (int, float)) and not isinstance(value, bool)
        value = float(value) if fits else value
    elif isinstance(old, tuple):
        fits = isinstance(value, (list, tuple))
        value = tuple(value) if fits else value
    else:
        fits = isinstance(value, type(old))
    if not fits and not hasattr(value, "dtype"):
        kind = wanted.get(type(old), "a list")
        raise ConfigError(f"{dotted} in {origin} is {value!r}; it must be {kind}")
    return value
