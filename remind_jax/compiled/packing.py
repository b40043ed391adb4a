"""Many small arrays as one per type.

Every array that goes into or comes out of a compiled program costs the host some microseconds,
and a frame with its thresholds has four hundred.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from remind_jax.numerics.pytree import pytree
from remind_jax.observation import AnyArray


@dataclasses.dataclass(frozen=True)
class Layout:
    """How to find the leaves of a tree again, in their order."""

    structure: Any  # the tree without its leaves
    dtypes: tuple[str, ...]  # of each leaf
    shapes: tuple[tuple[int, ...], ...]  # of each leaf

    @classmethod
    def of(cls, tree: Any) -> Layout:
        """That of a tree of arrays or of their shapes; 64 bits only if JAX has them."""
        leaves, structure = jax.tree.flatten(tree)
        dtypes = tuple(str(jax.dtypes.canonicalize_dtype(leaf.dtype)) for leaf in leaves)
        return cls(structure, dtypes, tuple(tuple(leaf.shape) for leaf in leaves))

    @property
    def vector_types(self) -> list[str]:
        """Types of the packed vectors, in their order."""
        return sorted(set(self.dtypes))


@pytree
class Packed:
    """A tree of arrays, packed."""

    vectors: dict[str, AnyArray]  # by type: the values of its leaves, one leaf after the other
    layout: Layout = dataclasses.field(metadata={"static": True})

    @classmethod
    def of(cls, tree: Any) -> Packed:
        """Packs host arrays and numbers, or, under jit, traced ones.

        A leaf that is on a device is fetched.
        """
        traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))
        if not traced:
            tree = jax.tree.map(np.asarray, tree)
        leaves, layout = jax.tree.leaves(tree), Layout.of(tree)
        vectors = {
            dtype: _join(
                [leaf for leaf, own in zip(leaves, layout.dtypes, strict=True) if own == dtype]
            )
            for dtype in layout.vector_types
        }
        if not traced:
            vectors = {dtype: vector.astype(dtype) for dtype, vector in vectors.items()}
        return cls(vectors, layout)

    def unpack(self) -> Any:
        """The tree that was packed."""
        layout, leaves = self.layout, []
        taken = dict.fromkeys(self.vectors, 0)
        for dtype, shape in zip(layout.dtypes, layout.shapes, strict=True):
            start, taken[dtype] = taken[dtype], taken[dtype] + math.prod(shape)
            leaves.append(self.vectors[dtype][start : taken[dtype]].reshape(shape))
        return jax.tree.unflatten(layout.structure, leaves)


SMALL_BYTES = 1 << 16  # from here on to join an array takes longer than to hand it over


@pytree
class Bundle:
    """A tree of arrays of which the small ones are packed: a memory between two steps.

    A step reads and writes the memory array by array, and a memory has a hundred small ones.
    """

    small: Packed  # a list of leaves
    large: list[AnyArray]
    structure: Any = dataclasses.field(metadata={"static": True})
    is_small: tuple[bool, ...] = dataclasses.field(metadata={"static": True})  # of each leaf

    @classmethod
    def of(cls, tree: Any) -> Bundle:
        """Packs as `Packed.of` does; large leaves stay where they are."""
        leaves, structure = jax.tree.flatten(tree)
        is_small = tuple(leaf.size * leaf.dtype.itemsize < SMALL_BYTES for leaf in leaves)
        small = [leaf for leaf, one in zip(leaves, is_small, strict=True) if one]
        large = [leaf for leaf, one in zip(leaves, is_small, strict=True) if not one]
        return cls(Packed.of(small), large, structure, is_small)

    def unpack(self) -> Any:
        """The tree that was packed."""
        small, large = iter(self.small.unpack()), iter(self.large)
        leaves = [next(small if one else large) for one in self.is_small]
        return jax.tree.unflatten(self.structure, leaves)

    def read(self) -> Any:
        """The tree with its small leaves on the host, which outlive the buffers of this one."""
        vectors = {dtype: np.array(vector) for dtype, vector in self.small.vectors.items()}
        return dataclasses.replace(self, small=Packed(vectors, self.small.layout)).unpack()


def _join(leaves: Sequence[AnyArray]) -> AnyArray:
    """One vector of the values of all leaves."""
    if isinstance(leaves[0], np.ndarray):
        return np.concatenate([leaf.ravel() for leaf in leaves])
    return jnp.concatenate([leaf.ravel() for leaf in leaves])
