"""Records of arrays: frozen dataclasses that JAX takes apart and puts together."""

from __future__ import annotations

import dataclasses
from typing import TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def pytree(cls: type[T]) -> type[T]:
    """Makes a class a frozen dataclass and a JAX pytree whose leaves are its fields."""
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True)(cls))


def choose(chosen: Bool[Array, "..."], new: T, old: T) -> T:
    """Of each array the new one, which broadcasts, where chosen: by the leading axes of the old."""

    def pick(new: Array, old: Array) -> Array:
        return jnp.where(chosen.reshape(*chosen.shape, *(1,) * (old.ndim - chosen.ndim)), new, old)

    return jax.tree.map(pick, new, old)
