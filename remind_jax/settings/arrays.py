"""Settings as arrays, as compiled programs take them."""

from __future__ import annotations

from typing import Any, Self

import jax
import jax.numpy as jnp


class AsArrays:
    """A pytree of numbers that can be turned into arrays."""

    def as_arrays(self, scalar: Any = jnp.float32) -> Self:
        """The same values as arrays: floats as `scalar`, whole numbers as int32, gates as bool.

        Strong types keep a threshold from being rounded to the precision of what it is compared
        with, and keep Python numbers and arrays from compiling twice.
        """

        def convert(value: Any) -> jax.Array:
            array = jnp.asarray(value)
            if array.dtype == jnp.bool_:
                return array
            if jnp.issubdtype(array.dtype, jnp.integer):
                return array.astype(jnp.int32)
            return array.astype(scalar)

        return jax.tree.map(convert, self)
