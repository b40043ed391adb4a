"""What is wrong with arrays that were read from a file: pure checks on the host.

Each check yields nothing, or one phrase that names the array, what was found and what is allowed.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

# Of the length of a unit vector in float32, after many steps toward other unit vectors.
UNIT_TOLERANCE = 1e-3


def not_finite(name: str, values: Any) -> Iterator[str]:
    """Numbers that are no numbers."""
    values = np.asarray(values)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        num = int(np.sum(~np.isfinite(values)))
        yield f"'{name}' holds {num} values that are not finite"


def outside(
    name: str, values: Any, least: float, most: float = np.inf, where: Any = True
) -> Iterator[str]:
    """Values beyond their range, both ends allowed, where it matters."""
    values = np.asarray(values)
    wrong = ((values < least) | (values > most)) & np.asarray(where)
    if wrong.any():
        found = values[wrong][0]
        allowed = f"{least:g} or more" if most == np.inf else f"{least:g} to {most:g}"
        yield f"'{name}' holds {found:g}; allowed: {allowed}"


def not_unit(name: str, vectors: Any, where: Any) -> Iterator[str]:
    """Vectors `[..., D]` that have neither length 1 nor 0 where they are in use, `[...]`."""
    vectors = np.asarray(vectors)[np.asarray(where)].astype(np.float64)
    length = np.sqrt(np.sum(vectors * vectors, axis=-1))
    wrong = (np.abs(length - 1) > UNIT_TOLERANCE) & (length > 0)
    if wrong.any():
        yield f"'{name}' holds a vector of length {length[wrong][0]:g}; allowed: unit vectors"


def repeated(name: str, values: Any) -> Iterator[str]:
    """Values that are there twice."""
    found, counts = np.unique(np.asarray(values), return_counts=True)
    if (counts > 1).any():
        yield f"'{name}' holds {found[counts > 1][0]} twice; allowed: each once"
