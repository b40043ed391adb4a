"""Shape annotations are checked while the tests run."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeVar

import jaxtyping
from beartype import beartype
from jax.typing import ArrayLike

F = TypeVar("F", bound=Callable)

SHAPE = re.compile(r"(Float|Int|Bool|UInt8|Num|Shaped|Real|Key)\w*\[")


def check(function: F) -> F:
    """Checks arguments and result of a function where they are arrays.

    What containers are filled with is not checked: JAX fills them with batches, shapes and
    placeholders while it traces, and tests with what a function does not look at.
    """
    if function.__name__ == "__init__":
        return function
    shapes = {name: a for name, a in function.__annotations__.items() if SHAPE.search(str(a))}
    if not shapes:
        return function
    function.__annotations__ = shapes
    return beartype(function)


def switch_on() -> None:
    """Checks every function of the package that is imported from now on."""
    jaxtyping.Array = ArrayLike  # pyright: ignore[reportAttributeAccessIssue]  (tests pass NumPy's)
    jaxtyping.install_import_hook("remind_jax", "tests.shape_checks.check")
