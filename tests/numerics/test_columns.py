"""Columns of tables by name: read, made and replaced."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float, Int

from remind_jax.numerics.columns import Column, Table


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Visits(Table):
    """Of somebody, somewhere."""

    wholes: Int[Array, "V 3"]
    reals: Float[Array, "V 1"]
    photo: Float[Array, "V 2"]

    id = Column("wholes")
    is_open = Column("wholes", truth=True)
    size = Column("reals")
    last = Column("wholes")


def visits(xp) -> Visits:
    return Visits.of(
        photo=xp.ones((2, 2)),
        size=xp.array([0.5, 1.5]),
        is_open=xp.array([True, False]),
        last=xp.array([8, 9]),
        id=xp.array([4, 5]),
    )


@pytest.mark.parametrize("xp", [np, jnp])
def test_columns_stand_in_the_order_of_their_declaration(xp):
    table = visits(xp)
    assert isinstance(table.wholes, np.ndarray if xp is np else jax.Array)
    np.testing.assert_array_equal(table.wholes, [[4, 1, 8], [5, 0, 9]])
    np.testing.assert_array_equal(table.reals, [[0.5], [1.5]])
    assert table.is_open.tolist() == [True, False]
    assert Visits.last.index == 2


def test_what_is_not_replaced_stays():
    after = visits(jnp).replaced(last=jnp.array([1, 2]), photo=jnp.zeros((2, 2)))
    np.testing.assert_array_equal(after.wholes, [[4, 1, 1], [5, 0, 2]])
    np.testing.assert_array_equal(after.photo, 0.0)
    np.testing.assert_array_equal(after.size, [0.5, 1.5])


def test_a_number_fills_its_column():
    after = visits(jnp).replaced(is_open=True)
    assert after.is_open.tolist() == [True, True]


@pytest.mark.parametrize("name", ["id", "last"])
def test_a_table_without_some_column_is_refused(name):
    columns = {"id": np.arange(2), "is_open": np.ones(2, bool), "last": np.ones(2)}
    del columns[name]
    with pytest.raises(KeyError):
        Visits.of(photo=np.ones((2, 2)), size=np.ones(2), **columns)
