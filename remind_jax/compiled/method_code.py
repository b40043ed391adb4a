"""What a method of one's own is made of: results are taken up only from the same one."""

from __future__ import annotations

import hashlib
import types
import uuid
from pathlib import Path
from typing import Any

import jax
import numpy as np

from remind_jax.compiled.programs import identify, is_of_this_package
from remind_jax.method import Method


def code_of(method: Method) -> str:
    """Functions that are not of this package, their files, and the values that are bound to them.

    What the files import, and their globals, are not looked at.
    """
    return _text_of_method(method, [])


def digest_of(method: Method) -> str | None:
    """What tells its code from other code; None of a shipped method, and where nobody can tell."""
    code = code_of(method)
    is_known = code and code == code_of(method)
    return hashlib.sha256(code.encode()).hexdigest()[:16] if is_known else None


def _text_of_method(method: Method, told: list[Any]) -> str:
    given = (method.init, method.describe, method.decide, *vars(method.needs).values())
    functions = (one for one in given if callable(one) and not is_of_this_package(one))
    return "".join(_text_of(one, told) for one in functions)


def _text_of(value: Any, told: list[Any]) -> str:
    """What tells a value from others, in any process; a function that was told of is left out."""
    if isinstance(value, Method):
        return value.name + _text_of_method(value, told)
    if callable(value) and not isinstance(value, type):
        if is_of_this_package(value):
            return str(identify(value))
        if any(value is one for one in told):
            return ""
        told.append(value)
        return _text_around(value) + _text_of(_bound(value), told)
    if isinstance(value, np.ndarray | jax.Array):
        digest = hashlib.sha256(np.asarray(value).tobytes()).hexdigest()
        return f"{value.dtype}{value.shape}{digest}"
    leaves, structure = jax.tree.flatten(value)
    is_tree = len(leaves) > 0 and leaves[0] is not value
    text = str(structure) if is_tree else repr(value)
    if " at 0x" in text:  # another one in every process, and nobody can tell what it holds
        return uuid.uuid4().hex
    return text + ",".join(_text_of(leaf, told) for leaf in leaves if is_tree)


def _text_around(function: Any) -> str:
    """A function and the file that it was compiled from, if it is not one that calls another."""
    try:
        code = function.__code__
        return f"{code.co_firstlineno}{Path(code.co_filename).read_text()}"
    except AttributeError:
        calls_another = hasattr(function, "func") or hasattr(function, "__wrapped__")
        return "" if calls_another else uuid.uuid4().hex
    except OSError:  # of a notebook or a prompt nobody can tell what it was
        return uuid.uuid4().hex


def _bound(function: Any) -> list[Any]:
    """What a function is made with: arguments, defaults, other functions, names from around it."""
    names = (
        "func",
        "args",
        "keywords",
        "__wrapped__",
        "__self__",
        "__defaults__",
        "__kwdefaults__",
    )
    cells = getattr(function, "__closure__", None) or ()
    return [
        *(getattr(function, name, None) for name in names),
        *(cell.cell_contents for cell in cells if cell != types.CellType()),
    ]
