"""Constant arrays made on the host, where JAX would compile a small program for every shape.

They stand wherever JAX takes arrays; `jax.device_put` brings a tree of them to the device.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from jaxtyping import Array


def full(shape: int | tuple[int, ...], value: float | Sequence[float], dtype: Any) -> Array:
    """An array of one value, or of one along the last axis."""
    return cast(Array, np.full(shape, value, dtype))


def zeros(shape: int | tuple[int, ...], dtype: Any = float) -> Array:
    """An array of zeros, or of False."""
    return cast(Array, np.zeros(shape, dtype))


def number(value: int) -> Array:
    """A whole number, int32."""
    return cast(Array, np.array(value, np.int32))


def eye(rows: int, columns: int) -> Array:
    """Ones on the diagonal, zeros elsewhere; float32."""
    return cast(Array, np.eye(rows, columns, dtype=np.float32))
