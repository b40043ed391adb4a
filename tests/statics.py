"""Capacities with the switches of the paper's tracker, and parts of any record, by name."""

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

from remind_jax.remind.method import METHOD
from remind_jax.remind.switches import Switches
from remind_jax.static import Static

_NAMES = {field.name for field in dataclasses.fields(Switches)}


def make_static(**fields: Any) -> Static:
    """The published ones but for these."""
    return change_static(METHOD.static(), **fields)


def change_static(static: Static, **fields: Any) -> Static:
    """The same but for these."""
    switches = {name: fields.pop(name) for name in _NAMES & set(fields)}
    changed = dataclasses.replace(static.switches, **switches)
    return dataclasses.replace(static, switches=changed, **fields)


_Whole = TypeVar("_Whole")


def only(kind: type[_Whole], **fields: Any) -> _Whole:
    """A record of which nothing but these fields is looked at: the others are None."""
    absent = {field.name: None for field in dataclasses.fields(kind)}  # pyright: ignore[reportArgumentType]
    return kind(**{**absent, **fields})


def change_parts(whole: _Whole, **parts: Mapping[str, Any]) -> _Whole:
    """A record of records, the same but for these fields of its parts."""
    changed = {
        name: dataclasses.replace(getattr(whole, name), **fields) for name, fields in parts.items()
    }
    return dataclasses.replace(whole, **changed)  # pyright: ignore[reportArgumentType]
