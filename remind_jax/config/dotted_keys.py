"""Nested values as dotted keys, `thresholds.matching.match`, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from remind_jax.settings.record import walk_settings


def flatten(
    tree: Mapping[str, Any], path: str = "", *, with_empty: bool = False
) -> Iterator[tuple[str, Any]]:
    """Walks nested values as dotted keys; of sections only the empty ones, if they are wanted."""
    for key, value in tree.items():
        dotted = f"{path}.{key}" if path else str(key)
        if isinstance(value, Mapping) and (value or not with_empty):
            yield from flatten(value, dotted, with_empty=with_empty)
        else:
            yield dotted, value


def flatten_fields(node: Any) -> Iterator[tuple[str, Any]]:
    """Walks the fields of nested dataclasses as dotted keys."""
    return ((key, value) for key, value, _ in walk_settings(node))


def nest(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted keys as nested values; undoes `flatten`."""
    nested: dict[str, Any] = {}
    for path, value in flat.items():
        *sections, name = path.split(".")
        node = nested
        for section in sections:
            node = node.setdefault(section, {})
        node[name] = value
    return nested
