"""Records of arrays: frozen dataclasses that JAX takes apart and puts together."""

from __future__ import annotations

import dataclasses
from typing import TypeVar, dataclass_transform

import jax

T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def pytree(cls: type[T]) -> type[T]:
    """Makes a class a frozen dataclass and a JAX pytree whose leaves are its fields."""
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True)(cls))
