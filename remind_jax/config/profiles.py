"""Profiles: thresholds that `remind calibrate` made for one backbone, kept where runs find them."""

from __future__ import annotations

import hashlib
import os
import re
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from remind_jax.errors import ConfigError
from remind_jax.files import as_path, make_folder, records, replace_file, user_cache_folder
from remind_jax.files.records import Count, Label, Text

VARIABLE = "REMIND_PROFILES"  # names another folder
_MAX_NAME = 80  # characters of a backbone's name in the name of a file


class MadeFor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Whose features thresholds fit, and what they were estimated from."""

    backbone: Text
    fingerprint: Text  # `Backbone.fingerprint`
    scenes: list[Text] = []
    evidence: Label = ""
    same: Count = 0  # comparisons of an object with itself
    other: Count = 0  # of two objects
    seed: Count = 0
    version: Label = ""

    @property
    def name(self) -> str:
        """What the profile is called: the backbone, and a hash of its fingerprint."""
        return name_profile(self.backbone, self.fingerprint)


def name_profile(backbone: str, fingerprint: str) -> str:
    """What a profile of these features is called; fit for the name of a file."""
    digest = hashlib.sha256(f"{backbone}\n{fingerprint}".encode()).hexdigest()[:12]
    return f"{re.sub(r'[^A-Za-z0-9_.+-]', '_', backbone)[:_MAX_NAME]}-{digest}"


def profile_folder() -> Path:
    """Where profiles are: as REMIND_PROFILES says, or cached. Raises ConfigError for a file."""
    named = os.environ.get(VARIABLE)
    if not named:
        return user_cache_folder() / "profiles"
    folder = as_path(named, f"the folder in {VARIABLE}", ConfigError)
    is_none = str(folder) == os.devnull  # said on purpose
    if os.path.lexists(folder) and not folder.is_dir() and not is_none:
        raise ConfigError(f"{VARIABLE} names '{folder}', which is no folder; give one")
    return folder


def place_profile(tracker: str, backbone: str, fingerprint: str) -> Path:
    """Where the profile of these features is looked for."""
    return profile_folder() / tracker / f"{name_profile(backbone, fingerprint)}.yaml"


def has_profile(tracker: str, backbone: str) -> bool:
    """Whether a profile of a backbone of this name is kept, whatever its weights."""
    names = [path.stem for path in (profile_folder() / tracker).glob("*.yaml")]
    start = name_profile(backbone, "").rpartition("-")[0]
    return any(name.rpartition("-")[0] == start for name in names)


def read_made_for(value: Any, origin: str) -> MadeFor:
    """What a file says about the features that it fits."""
    try:
        return msgspec.convert(value, MadeFor)
    except msgspec.ValidationError as error:
        raise ConfigError(
            f"profile in {origin} is not what 'remind calibrate' writes ({error}); calibrate again"
        ) from error


def write_profile(path: Path, tracker: str, made_for: MadeFor, values: Mapping[str, Any]) -> None:
    """Writes a profile, whole or not at all."""
    import yaml

    tree = {"base": tracker, "profile": msgspec.to_builtins(made_for), "thresholds": values}
    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, width=100)
    head = "# Thresholds for the features of one backbone, made by `remind calibrate`.\n"
    make_folder(path.parent)
    replace_file(path, (head + text).encode())


def read_profile(path: Path, tracker: str, name: str) -> dict[str, Any]:
    """Reads the thresholds of a profile of this tracker and name."""
    values = records.read_yaml(path, dict[str, Any], refused=ConfigError)
    wrong = ""
    if set(values) != {"base", "profile", "thresholds"}:
        wrong = "is no profile of 'remind calibrate'"
    elif values["base"] != tracker:
        wrong = f"starts from `base`: {reprlib.repr(values['base'])} instead of {tracker!r}"
    elif (found := read_made_for(values["profile"], str(path)).name) != name:
        wrong = f"is a profile of {found}, not of {name}"
    if wrong:
        raise ConfigError(f"'{path}' {wrong}; calibrate again, or remove it")
    return {"thresholds": values["thresholds"]}
