"""What a setting means, in words, from its record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from remind_jax.config.config import Config
from remind_jax.config.keys import full_key, keys_below
from remind_jax.settings.record import Setting, walk_settings


def describe_settings(config: Config, names: Sequence[str]) -> Iterator[str]:
    """A few lines about every setting that is named.

    Args:
      config: Where the settings and their values are.
      names: Keys or sections, written as anywhere else (`config/keys.py`).

    Raises:
      ConfigError: If one of them is unknown, or may be several.
    """
    settings = {key: (value, record) for key, value, record in walk_settings(config)}
    del settings["chosen"]
    for name in names:
        found = keys_below(name, settings) or [
            full_key(name, settings, config.tracker, "'remind config describe'")
        ]
        for key in found:
            yield from _describe(key, *settings[key])


def _describe(key: str, value: Any, record: Setting) -> Iterator[str]:
    shown = str(value).lower() if isinstance(value, bool) else value
    yield f"{key}: {shown}{f' ({record.unit})' if record.unit else ''}"
    facts = (
        ("", record.meaning),
        ("larger: ", record.more),
        (f"at most {record.most}: ", record.why),
        ("in the paper: ", record.symbol),
        ("in the original: ", ", ".join((*record.own_keys, *record.decided_by))),
    )
    yield from (f"  {head}{words}" for head, words in facts if words)
