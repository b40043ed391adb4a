"""One record per setting, in the metadata of its dataclass field.

    match: Real = setting(0.75, "least final score of a match", "score",
        symbol="τ_match", key="association.matching.match_thr")

The page of settings, the checks, the help of `remind config` and the import of the original's files
follow from it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any


@dataclasses.dataclass(frozen=True)
class Setting:
    """What is known of one setting beside its value."""

    meaning: str
    unit: str = ""  # of a number
    more: str = ""  # what a larger number does
    symbol: str = ""  # in the paper, `letter_index`
    key: str | tuple[str, ...] = ""  # in the original; for a tuple, of each of its places
    theirs: Mapping[Any, Any] | None = None  # the original's values, and what they are here
    listed: str = ""  # the setting holds if the original's list has this name
    decided_by: tuple[str, ...] = ()  # keys of the original that decide it together
    least: float | None = None  # allowed number
    most: float | None = None  # allowed number
    why: str = ""  # not more
    not_below: str = ""  # setting of the same section that may not be larger

    @property
    def own_keys(self) -> tuple[str, ...]:
        """Keys of the original that decide it alone, each once."""
        keys = (self.key,) if isinstance(self.key, str) else self.key
        return tuple(dict.fromkeys(filter(None, keys)))


def setting(value: Any, meaning: str, unit: str = "", **more: Any) -> Any:
    """A dataclass field with its default value and its record; arguments as of `Setting`."""
    record = Setting(meaning, unit, **more)
    return dataclasses.field(default=value, metadata={"setting": record})


def walk_settings(node: Any, path: str = "") -> Iterator[tuple[str, Any, Setting]]:
    """Dotted key, value and record of every field of nested dataclasses.

    A field without a record, as those of a method of your own may be, has an empty one.

    Args:
      node: A dataclass with values.
      path: What keys begin with, with its dot.
    """
    for field in dataclasses.fields(node):
        value = getattr(node, field.name)
        if dataclasses.is_dataclass(value):
            yield from walk_settings(value, f"{path}{field.name}.")
        else:
            yield f"{path}{field.name}", value, field.metadata.get("setting", Setting(""))
