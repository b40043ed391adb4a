"""`Config`: static structure, thresholds and input options, read from strict YAML."""

from __future__ import annotations

import dataclasses
import os
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from remind_jax.config.dotted_keys import flatten, flatten_fields, nest
from remind_jax.config.files import beside, find_file, find_profile, list_configs, read_yaml
from remind_jax.config.keys import SWITCHES, THRESHOLDS, flat_keys
from remind_jax.config.profiles import name_profile, place_profile, read_made_for, read_profile
from remind_jax.config.reference_keys import translate
from remind_jax.errors import ConfigError
from remind_jax.files import records
from remind_jax.method import PAPER_METHOD, get_method
from remind_jax.remind.switches import Switches
from remind_jax.remind.thresholds import Thresholds
from remind_jax.settings.ranges import check_fields, check_order, check_range
from remind_jax.settings.record import Setting, setting
from remind_jax.static import Static

_LARGEST = 3e38  # thresholds are traced in single precision


# fmt: off


@dataclasses.dataclass(frozen=True)
class Input:
    """How frames and masks are prepared on the host.

    Rules: method.md#frame-size, method.md#filled-mask.
    """

    max_width_px: int = setting(1280, "wider frames are reduced to this width", "px",
        more="finer patches of wide frames, more time", key="system.input_width_size")
    center_crop: bool = setting(True,
        "crop to whole patches around the center, else at the top left",
        key="perception.full_center_crop")
    ignored_classes: tuple[str, ...] = setting(("wall", "floor", "ceiling", "object"),
        "detections of these classes are left out", key="detector.ignored_classes")
    sanitize: Literal["convex_hull", "morphology", "none"] = setting("convex_hull",
        "how a mask is filled before its surroundings are described",
        decided_by=("bg_local.sanitize.enabled", "bg_local.sanitize.mode"))
    keep_largest: bool = setting(False,
        "look at the background around the largest piece of a mask only",
        key="bg_local.sanitize.keep_largest_component")
    fill_holes: bool = setting(True, '"morphology": fill holes', key="bg_local.sanitize.fill_holes")
    close_px: int = setting(3, '"morphology": side of the closing square', "px",
        more="larger gaps in masks are closed", least=0, most=1000,
        why="which is wider than things are",
        key="bg_local.sanitize.close_px")
    open_px: int = setting(0, '"morphology": side of the opening square, 0: none', "px",
        more="larger specks of masks vanish", least=0, most=1000,
        why="which is wider than things are",
        key="bg_local.sanitize.open_px")
    erosion_px: int = setting(0, "masks lose so many pixels on every side first", "px",
        more="masks shrink more; less background in the appearance", least=0, most=1000,
        why="which is wider than things are",
        decided_by=("davis.mask_erosion_px", "davis.mask_erosion_iters"))
    closeups: Literal["auto", "always", "never"] = setting("auto",
        "describe every detection in a picture of its own instead of the frame; \"auto\": if the "
        "tracker prefers that, and the backbone has features of its own for them")
    announce_after: int = setting(0,
        "detections after which an object gets its id. 0: 1 for given masks, 5 for a detector",
        "detections", more="fewer objects that never were, each known later", least=0)
    class_agnostic: bool = setting(False, "compare all detections whatever their classes")
    double_overlap: float = setting(0.0, "intersection over union from which on the lesser of two "
        "detections of a class is left out as a second one of the same thing. 0: none is", "share",
        more="more overlap is needed", least=0.0, most=1.0)
    max_objects: int = setting(0, "objects that are remembered; beyond, those that were seen least "
        "and longest ago are forgotten. 0: all", "objects", more="more memory", least=0)
    keep_pictures: bool = setting(True,
        "keep up to three small pictures of each object in memory and its file")

    # fmt: on

    def __post_init__(self) -> None:
        check_fields(self, "input")


@dataclasses.dataclass(frozen=True)
class Config:
    """Everything that can be chosen for a run, apart from its input and its backbone."""

    tracker: str = setting(PAPER_METHOD, "name of the method, see `remind_jax.method`")
    input: Input = dataclasses.field(default_factory=Input)
    static: Static = dataclasses.field(default_factory=lambda: Static(switches=Switches()))
    # Those of REMIND, as its switches in `static`; other trackers have their own.
    thresholds: Thresholds | Any = dataclasses.field(default_factory=Thresholds)
    backbone_profile: bool = setting(False, "what nobody chose follows configs/backbones/NAME.yaml")
    profile: str = setting("", "profile that the thresholds are from (remind calibrate)")
    # Dotted keys that a file, values or `--set` gave, whatever the value: no profile changes them.
    chosen: frozenset[str] = dataclasses.field(default=frozenset(), compare=False, repr=False)

    @property
    def keys(self) -> list[str]:
        """All keys that can be given a value, dotted."""
        return [key for key, _ in flatten_fields(self) if key != "chosen"]

    def to_dict(self) -> dict[str, Any]:
        """Plain nested values, fit for YAML and JSON."""
        values = dataclasses.asdict(self)
        del values["chosen"]
        if not values["static"]["switches"]:  # of a method without any
            del values["static"]["switches"]
        return _plain(values)

    def updated(
        self, changes: Mapping[str, Any], origin: str = "changes", *, ordered: bool = True
    ) -> Config:
        """A copy with some values changed, e.g. `{"thresholds": {"matching": {"match": 0.7}}}`.

        Unless `ordered`, a least may be above its most.

        Raises:
          ConfigError: For an unknown key or a value of the wrong kind.
        """
        changes = dict(_as_nested(changes, origin))
        tracker = changes.pop("tracker", None)
        start = self if tracker is None else self.with_tracker(_as_tracker(tracker, origin))
        flat = flat_keys(changes, start.keys, start.tracker, origin)
        chosen = start.chosen | flat.keys() | ({"tracker"} if tracker is not None else set())
        filled = _update(start, nest(flat), (), origin, ordered)
        return dataclasses.replace(filled, chosen=chosen)

    def with_tracker(self, name: str) -> Config:
        """The configuration for another tracker; input stays, and static where it was chosen.

        Thresholds are those of the shipped configuration of that name, where there is one, else
        the published ones of the tracker; so is static if it was that of the tracker before.

        Raises:
          ConfigError: If there is no such tracker.
        """
        if _as_tracker(name, "a call") == self.tracker:
            return self
        get_method(name)
        before, start = (
            load_config(one) if one in list_configs() else _neutral(one)
            for one in (self.tracker, name)
        )
        static = start.static
        shared = dataclasses.replace(self.static, switches=before.static.switches)
        if shared != before.static:
            static = dataclasses.replace(shared, switches=static.switches)
        own = (THRESHOLDS, SWITCHES)
        chosen = {key for key in self.chosen if not key.startswith(own)}
        chosen |= {key for key in start.chosen if key.startswith(own)}
        return dataclasses.replace(
            self,
            tracker=name,
            static=static,
            thresholds=start.thresholds,
            chosen=frozenset(chosen),
        )

    def difference(self, other: Config) -> list[tuple[str, Any, Any]]:
        """Keys whose values differ, with this value and the other's (None: it has no such key)."""
        if not isinstance(other, Config):
            raise ConfigError(
                f"a configuration was compared with a {type(other).__name__}; give a Config"
            )
        mine, theirs = dict(flatten(self.to_dict())), dict(flatten(other.to_dict()))
        return [(key, mine[key], theirs.get(key)) for key in mine if mine[key] != theirs.get(key)]

    def for_backbone(self, name: str, fingerprint: str | None = None) -> Config:
        """The configuration with the profile of a backbone, where there is one and it is wanted.

        Published thresholds belong to the features that they were tuned on. A profile gives values
        to keys that nobody chose: that are not `chosen` and have their published value. One that
        `remind calibrate` made for these very features comes before the shipped one. Once more
        changes nothing.

        Raises:
          ConfigError: If the configuration is a profile of other features.
        """
        if not isinstance(name, str):
            raise ConfigError(f"the backbone is {reprlib.repr(name)}; give its name")
        if self.profile:
            wanted = None if fingerprint is None else name_profile(name, fingerprint)
            if wanted not in (None, self.profile):
                raise ConfigError(
                    f"the thresholds are a profile of {self.profile}, but the features are those "
                    f"of {wanted}; calibrate for this backbone (remind calibrate SCENES --backbone "
                    "NAME), or leave out --config"
                )
            return self
        if not self.backbone_profile:
            return self
        path, calibrated = find_profile(self.tracker, name), ""
        if fingerprint is not None:
            made_here = place_profile(self.tracker, name, fingerprint)
            if os.path.lexists(made_here):  # whatever lies there is not passed over
                path, calibrated = made_here, name_profile(name, fingerprint)
        if path is None:
            return self
        values = read_profile(path, self.tracker, calibrated) if calibrated else read_yaml(path)
        profile = flat_keys(values, self.keys, self.tracker, str(path))
        mine, published = dict(flatten_fields(self)), dict(flatten_fields(_neutral(self.tracker)))
        free = {
            key: value
            for key, value in profile.items()
            if key not in self.chosen and mine[key] == published[key]
        }
        filled = _update(self, nest(free), (), str(path))
        return dataclasses.replace(filled, profile=calibrated)

    @classmethod
    def from_reference(cls, settings: Mapping[str, Any] | str | Path) -> Config:
        """Reads settings written for the original implementation.

        Args:
          settings: Nested keys as in the original's YAML, or the path of such a file; what is
            left out keeps the published value.

        Raises:
          ConfigError: For a key that the original does not have, or a value that is not supported.
        """
        origin = "settings of the original"
        if not isinstance(settings, (str, Path, Mapping)):
            raise ConfigError(
                f"{origin} are of type {type(settings).__name__}; give nested values, or the path "
                "of a YAML file"
            )
        values = settings if isinstance(settings, Mapping) else read_yaml(Path(settings))
        return cls().updated(translate(_as_nested(values, origin), cls()), origin)


def load_config(name: str | Path | Config | Mapping[str, Any] = "default") -> Config:
    """Gives a configuration by name, by file, or from nested values.

    Args:
      name: Name of a shipped configuration, path of a YAML file, nested values on top of their
        `base` (`default` if they name none), or a `Config` that is returned as it is.

    Raises:
      ConfigError: If there is no such configuration or it holds an unknown key or a wrong value.

    Example:
      >>> load_config("published").thresholds.matching.match
      0.75
      >>> load_config({"decision": {"new": 1.5}}).thresholds.decision.new
      1.5
    """
    if isinstance(name, Config):
        _check_thresholds(name.thresholds, "thresholds.")
        return name
    if not isinstance(name, (str, Path, Mapping)):
        raise ConfigError(
            f"the configuration is of type {type(name).__name__}; give a name, a .yaml file, "
            "nested values, or a Config"
        )
    return _load(name, ())


def _load(name: str | Path | Mapping[str, Any], opened: tuple[str, ...]) -> Config:
    """Reads a configuration; `opened` are the files that start from it, one from the next."""
    if isinstance(name, Mapping):
        origin, values = "changes", {"base": "default", **_as_nested(name, "changes")}
    else:
        path = find_file(name)
        origin, values = str(path), read_yaml(path)
        if origin in opened:
            circle = " -> ".join((*opened[opened.index(origin) :], origin))
            raise ConfigError(f"configurations start from each other in a circle: {circle}")
        opened = (*opened, origin)
    base, made_for = values.pop("base", None), values.get("profile")
    if isinstance(made_for, Mapping):
        values["profile"] = read_made_for(made_for, origin).name
    if base is None:
        tracker = _as_tracker(values.get("tracker", PAPER_METHOD), origin)
        return _neutral(tracker).updated(values, origin)
    if not isinstance(base, (str, Path)):
        raise ConfigError(
            f"base in {origin} is {base!r}; it must be the name of a configuration or a .yaml file"
        )
    if not isinstance(name, Mapping):
        base = beside(Path(origin), base)
    return _load(base, opened).updated(values, origin)


def _neutral(tracker: str) -> Config:
    """A tracker with everything as published."""
    method = get_method(tracker)
    return Config(tracker=tracker, static=method.static(), thresholds=method.settings())


def _as_tracker(name: Any, origin: str) -> str:
    """What should be the name of a tracker."""
    if not isinstance(name, str):
        shown = reprlib.repr(name)
        raise ConfigError(
            f"tracker in {origin} is {shown}; it must be the name of a tracker (`register_method` "
            "adds one of your own)"
        )
    return name


def _as_nested(values: Any, origin: str) -> dict[str, Any]:
    """Nested values of bounded depth and size by their keys."""
    values = dict(values) if isinstance(values, Mapping) else values
    return records.check(values, dict[str, Any], origin, refused=ConfigError)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    return value.item() if hasattr(value, "item") else value


def _update(
    node: Any, changes: Mapping[str, Any], path: tuple[str, ...], origin: str, ordered: bool = True
) -> Any:
    """Replaces fields of nested dataclasses, checking kinds; all of them are there."""
    updated = {}
    for key, value in changes.items():
        old, below = getattr(node, key), (*path, key)
        record = type(node).__dataclass_fields__[key].metadata.get("setting", Setting(""))
        if dataclasses.is_dataclass(old):
            updated[key] = _update(old, value, below, origin, ordered)
        else:
            name = f"{'.'.join(below)} in {origin}"
            updated[key] = _coerce(value, old, name)
            if path[:1] != ("static",):  # counts have ranges of their own
                check_range(name, updated[key], record)
    node = dataclasses.replace(node, **updated)
    if ordered:
        check_order(node, "".join(f"{part}." for part in path))
    return node


def _check_thresholds(section: Any, path: str) -> None:
    """Checks thresholds that were put together in Python; arrays pass, they are sweeps."""
    check_order(section, path)
    for field in dataclasses.fields(section):
        value = getattr(section, field.name)
        if dataclasses.is_dataclass(value):
            _check_thresholds(value, f"{path}{field.name}.")
        elif isinstance(value, (int, float)):
            check_range(f"{path}{field.name}", value, field.metadata.get("setting", Setting("")))
        elif not hasattr(value, "dtype") and not field.metadata.get("static"):
            raise ConfigError(f"{path}{field.name} is {value!r}; it must be a number")


def _coerce(value: Any, old: Any, name: str) -> Any:
    """The value in the kind of the one that it replaces; arrays pass, they are sweeps."""
    if isinstance(value, np.generic):
        value = value.item()
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if isinstance(old, bool):
        fits, wanted = isinstance(value, bool), "true or false"
    elif isinstance(old, int):
        fits = is_number and isinstance(value, int) and -(2**31) <= value < 2**31
        wanted = "a whole number of at most 31 bits"
    elif isinstance(old, float):
        fits = is_number and abs(value) <= _LARGEST  # NaN is not
        wanted = "a finite number" if is_number else "a number"
        value = float(value) if fits else value
    elif isinstance(old, tuple):
        fits, wanted = isinstance(value, (list, tuple)), "a list"
        value = tuple(value) if isinstance(value, list) else value
    else:
        fits, wanted = isinstance(value, type(old)), "a text" if isinstance(old, str) else "a list"
    if not fits and not hasattr(value, "dtype"):
        raise ConfigError(f"{name} is {reprlib.repr(value)}; it must be {wanted}")
    return value
