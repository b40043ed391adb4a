"""Shape annotations are checked while the tests run."""

import re
from collections.abc import Callable
from typing import Any, TypeVar

import jaxtyping
from beartype import beartype
from jax.typing import ArrayLike
from jaxtyping import jaxtyped

F = TypeVar("F", bound=Callable)

SHAPE = re.compile(r"(Float|Int|Bool|UInt8|Num|Shaped|Real|Key)\w*\[")


def check(function: F) -> F:
    """Checks arguments and result of a function where they are arrays.

    What containers are filled with is not checked: JAX fills them with batches, shapes and
    placeholders while it traces, and tests with what a function does not look at.
    """
    function.__annotations__ = shapes_of(function)
    return beartype(function)


def shapes_of(function: Callable) -> dict[str, Any]:
    """The annotations that say a shape."""
    return {name: a for name, a in function.__annotations__.items() if SHAPE.search(str(a))}


def check_if_shaped(*, typechecker: Any) -> Callable[[Any], Any]:
    """The decorator of jaxtyping, but only for functions that take or give arrays.

    It would slow down every other call, those within a trace above all, several times.
    """

    def decorate(what: Any) -> Any:
        is_shaped = not isinstance(what, type) and shapes_of(getattr(what, "__func__", what))
        return jaxtyped(what, typechecker=typechecker) if is_shaped else what

    return decorate


def switch_on() -> None:
    """Checks every function of the package that is imported from now on."""
    jaxtyping.Array = ArrayLike  # pyright: ignore[reportAttributeAccessIssue]  (tests pass NumPy's)
    jaxtyping.jaxtyped = check_if_shaped  # pyright: ignore[reportAttributeAccessIssue]
    jaxtyping.install_import_hook("remind_jax", "tests.shape_checks.check")
