"""Memory files of earlier versions: their arrays become the leaves of a memory of now."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from remind_jax.decision import no_decisions
from remind_jax.method import Method, named_leaves
from remind_jax.static import Static

EARLIER_VERSIONS = ("7", "8")  # of the schema, which are read as well
WITH_OTHER_DECISIONS = "7"  # whose decisions of the last frame are read as none

Columns = Mapping[str, tuple[int, tuple[str, ...]]]  # as `method.Host.columns`


def as_now(
    tensors: Mapping[str, np.ndarray],
    schema: str,
    method: Method,
    static: Static,
    leaves: Mapping[str, Any],
) -> dict[str, np.ndarray]:
    """The tensors of a file by the names of the leaves of a memory.

    Leaves that there were not yet are what the others say, else as in an empty memory; places that
    there were not yet are zero. `leaves` are the shapes and types of all leaves.
    """
    found = {name: one for name, one in tensors.items() if name not in method.host.gone_leaves}
    if schema in EARLIER_VERSIONS:
        found = split_columns(found, method.host.columns, leaves)
    if schema == WITH_OTHER_DECISIONS:
        # Nothing goes on from the decisions of the last frame.
        found = {name: one for name, one in found.items() if not name.startswith("decisions.")}
        blank = named_leaves(no_decisions(static))
        found |= {f"decisions.{name}": np.asarray(leaf) for name, leaf in blank}
    for name in method.host.lengthened:
        leaf = found.get(name)
        if leaf is not None and leaf.ndim == leaves[name].ndim:
            lacking = max(0, leaves[name].shape[1] - leaf.shape[1])
            found[name] = np.pad(leaf, [(0, 0), (0, lacking), *[(0, 0)] * (leaf.ndim - 2)])
    if missing := [name for name in method.host.new_leaves if name not in found]:
        empty = dict(named_leaves(method.make_empty(static)))
        for name in missing:
            make = method.host.new_leaves[name]
            with contextlib.suppress(KeyError, ValueError):  # what lacks is found later
                leaf = empty[name] if make is None else make(found)
                found[name] = np.array(leaf, empty[name].dtype)
    return found


def split_columns(
    tensors: Mapping[str, np.ndarray], columns: Columns, leaves: Mapping[str, Any]
) -> dict[str, np.ndarray]:
    """The tensors by the names of the leaves of a memory; what lacks columns is left out."""
    found = dict(tensors)
    for name, (axis, parts) in columns.items():
        if name not in found or not found[name].ndim:
            continue
        values = np.moveaxis(found.pop(name), axis, -1)
        at = 0
        for part in parts:
            leaf = leaves[part]
            is_one = leaf.ndim < values.ndim
            width = 1 if is_one else leaf.shape[-1]
            column = values[..., at : at + width]
            if column.shape[-1] == width:
                column = column[..., 0] if is_one else column
                found[part] = np.array(column, leaf.dtype, order="C")
            at += width
    return found
