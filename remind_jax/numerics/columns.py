"""Tables whose columns have names: few large arrays where each column would be one of its own.

What a compiled program reads, looks up, selects and writes, it does array by array; a table that is
looked up as a whole is one step where its columns would be ten. Truth values stand in tables of
whole numbers as 0 and 1.

    @jax.tree_util.register_dataclass
    @dataclasses.dataclass(frozen=True)
    class Visits(Table):
        wholes: Int[Array, "V 2"]
        id = Column("wholes")
        is_open = Column("wholes", truth=True)

    visits.id                                     [V]
    visits.replaced(is_open=visits.id > 3)
    Visits.of(id=ids, is_open=is_open)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Shaped


class Column:
    """A column of a table; reads as an array without the axis of columns."""

    def __init__(self, array: str, *, truth: bool = False) -> None:
        """Columns of one array stand in the order in which they are declared.

        Args:
          array: Field of the table that holds it, along the last axis.
          truth: Reads as truth values.
        """
        self.array, self.truth = array, truth
        self.index = 0

    def __set_name__(self, owner: type[Table], name: str) -> None:
        """Stands behind the columns of the same array that were declared before."""
        before = owner.__dict__.get("columns", {})
        self.index = sum(one.array == self.array for one in before.values())
        owner.columns = {**before, name: self}

    def __get__(self, table: Any, owner: type | None = None) -> Any:
        """Its values."""
        if table is None:
            return self
        values = getattr(table, self.array)[..., self.index]
        return values != 0 if self.truth else values


class Table:
    """Base of dataclasses of arrays whose columns have names."""

    columns: ClassVar[dict[str, Column]] = {}

    @classmethod
    def of(cls, **values: Any) -> Self:
        """A table of all its columns, and of its arrays without columns, by name."""
        return cls(**cls.columns_of(**values), **_without(values, cls.columns))

    @classmethod
    def columns_of(cls, **values: Any) -> dict[str, Any]:
        """The arrays whose columns are given."""
        return {
            array: _join([given[one.index] for one in cls.columns.values() if one.array == array])
            for array, given in cls._sort(values).items()
        }

    def replaced(self, **values: Any) -> Self:
        """With other values of some columns, or of some arrays as a whole."""
        arrays = {
            array: _put(given, getattr(self, array)) for array, given in self._sort(values).items()
        }
        others = _without(values, self.columns)
        return dataclasses.replace(cast(Any, self), **arrays, **others)

    @classmethod
    def _sort(cls, values: Mapping[str, Any]) -> dict[str, dict[int, Any]]:
        """Values of columns, by array and index."""
        sorted_values: dict[str, dict[int, Any]] = {}
        for name, column in cls.columns.items():
            if name in values:
                value = values[name]
                value = value if isinstance(value, np.ndarray) else jnp.asarray(value)
                value = value.astype(np.int32) if column.truth else value
                sorted_values.setdefault(column.array, {})[column.index] = value[..., None]
        return sorted_values


def _without(values: Mapping[str, Any], names: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name not in names}


def _join(columns: Sequence[Any]) -> Any:
    """An array of these columns; on the host if all of them are there."""
    if all(isinstance(column, np.ndarray) for column in columns):
        return np.concatenate(columns, axis=-1)
    shape = (*jnp.broadcast_shapes(*(column.shape[:-1] for column in columns)), len(columns))
    return _put(dict(enumerate(columns)), jnp.broadcast_to(columns[0], shape))


def _put(columns: Mapping[int, Any], array: Any) -> Any:
    """Each element selects its column, which is one step for all of them.

    What is concatenated is computed piece by piece.
    """
    on_host = all(isinstance(one, np.ndarray) for one in (array, *columns.values()))
    place, xp = np.arange(array.shape[-1]), np if on_host else jnp
    for index, column in columns.items():
        array = xp.where(place == index, column, array)
    return array


def columns(*values: Shaped[Array, "..."] | int) -> Shaped[Array, "... K"]:
    """Values side by side along a last axis.

    A choice by place becomes part of whatever reads it, where a concatenation is a kernel.
    """
    *others, chosen = jnp.broadcast_arrays(*values)
    chosen = chosen[..., None]
    place = np.arange(len(values))
    for index, value in enumerate(others):
        chosen = jnp.where(place == index, value[..., None], chosen)
    return chosen
