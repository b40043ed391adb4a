"""Names of settings: which dotted key somebody means, in files, values, `--set` and sweeps."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from remind_jax.config.dotted_keys import flatten, flatten_fields
from remind_jax.config.files import list_configs
from remind_jax.errors import ConfigError, close_names, nearest_names
from remind_jax.method import get_method, list_methods

THRESHOLDS = "thresholds."
STATIC = "static."
SWITCHES = "static.switches."


def full_key(name: str, known: Collection[str], tracker: str, origin: str) -> str:
    """The key that a name stands for. Raises ConfigError if it stands for none, or for several."""
    for key in (name, THRESHOLDS + name, name.replace(STATIC, SWITCHES, 1)):
        if key in known:
            return key
    if keys_below(name, known):
        keys = ", ".join(sorted(_below(name, known)))
        raise ConfigError(f"{name!r} in {origin} is a section; name one of its keys: {keys}")
    if name == "base":
        raise ConfigError(
            f"base cannot be changed by {origin}; it is what values start from: give it in a file, "
            "or with --config"
        )
    alike = [key for key in known if key.startswith(THRESHOLDS) and key.endswith(f".{name}")]
    if len(alike) == 1:
        return alike[0]
    if alike:
        raise ConfigError(f"{name!r} in {origin} may be {' or '.join(alike)}; give one of them")
    if owners := _owners(name, tracker):
        kind = "switch" if name.startswith(STATIC) else "threshold"
        shown = f"tracker{'s' * (len(owners) > 1)} {' and '.join(map(repr, owners))}"
        raise ConfigError(
            f"{name!r} in {origin} is a {kind} of {shown}, and tracker '{tracker}' is chosen; "
            f"give {how_to_choose(owners[0])}"
        )
    raise ConfigError(f"unknown key {name!r} in {origin}; {_nearest(name, known)}")


def flat_keys(
    changes: Mapping[str, Any], known: Collection[str], tracker: str, origin: str
) -> dict[str, Any]:
    """Nested values by full key. Raises ConfigError if one is unknown, given twice or a section."""
    flat: dict[str, Any] = {}
    written: dict[str, str] = {}
    for name, value in flatten(changes, with_empty=True):
        if keys_below(name, known):
            if not isinstance(value, Mapping):
                raise ConfigError(f"{name} in {origin} is {value!r}; it must hold keys and values")
            continue
        key = full_key(name, known, tracker, origin)
        if key in flat:
            raise ConfigError(
                f"{origin} gives {key} twice, as {written[key]!r} and as {name!r}; leave out one"
            )
        flat[key], written[key] = value, name
    return flat


def keys_below(name: str, known: Collection[str]) -> list[str]:
    """All keys in a section, in full; none if the name is no section."""
    starts = f"{name}.", f"{THRESHOLDS}{name}."
    return [key for key in known if key.startswith(starts)]


def how_to_choose(tracker: str) -> str:
    """What chooses a tracker: its configuration, where one is shipped."""
    option, key = ("config", "base") if tracker in list_configs() else ("tracker", "tracker")
    return f"--{option} {tracker}, or `{key}: {tracker}` in a file or in values"


def _owners(name: str, tracker: str) -> list[str]:
    """Other trackers that have such a threshold or switch."""
    bare = name.removeprefix(THRESHOLDS)
    return [
        other
        for other in list_methods()
        if other != tracker
        and any(key == bare or key.startswith(f"{bare}.") for key in _keys_of(other))
    ]


def _keys_of(tracker: str) -> Iterator[str]:
    """Its thresholds and switches, in short."""
    method = get_method(tracker)
    yield from (key for key, _ in flatten_fields(method.settings()))
    yield from (
        f"{start}{key}"
        for key, _ in flatten_fields(method.switches())
        for start in (STATIC, SWITCHES)
    )


def _nearest(name: str, known: Collection[str]) -> str:
    """Half a sentence with the keys that are most like a misspelled one."""
    section, _, last = name.rpartition(".")
    beside = _below(section, known) if section else []
    if beside:
        return nearest_names(last, beside)
    names = {key.removeprefix(THRESHOLDS) for key in known}
    names |= {key.rpartition(".")[0] for key in names} | {THRESHOLDS.rstrip(".")}
    names.discard("")
    close = [key for key in names if key.endswith(f".{name}")] or close_names(name, names)
    return nearest_names(name, close or {key.partition(".")[0] for key in names})


def _below(section: str, known: Collection[str]) -> list[str]:
    """Last parts of the keys right below a section."""
    return [
        key.rpartition(".")[2]
        for key in known
        if key.rpartition(".")[0] in (section, THRESHOLDS + section)
    ]
