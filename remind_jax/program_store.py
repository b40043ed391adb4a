"""Programs kept on disk as JAX traced them, beside those that it compiled.

JAX's compilation cache spares the compiler, not the tracing of Python, which for a tracker's step
takes several times as long as loading what was compiled. Kept in a folder of that cache; without
the cache, or without `flatbuffers`, nothing is kept.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from jax import export

_PACKAGE = Path(__file__).resolve().parent


def trace_once(function: Callable[..., Any], args: tuple, result: Any, key: tuple) -> Any:
    """`function(*args)` under `jit`, from the kept program if there is one.

    Results never depend on it: a program is found by the text of this package, the versions and
    settings of JAX, `key`, and the structure, shapes and types of `args`. A file that cannot be
    read is made anew; a folder that cannot be written to is left alone. A program that cannot be
    kept, as one with host callbacks, is traced as ever.

    Args:
      function: Pure, and of this package throughout: its text tells when it changes.
      args: Traced arrays in any structure.
      result: Something of the structure of what it returns.
      key: What the program depends on besides; its `repr` tells values apart.
    """
    folder = jax.config.values["jax_compilation_cache_dir"]
    # JAX writes programs with a library that it does not bring along.
    if not folder or importlib.util.find_spec("flatbuffers") is None:
        return function(*args)
    leaves, structure = jax.tree.flatten(args)
    if any(jax.typeof(leaf).weak_type for leaf in leaves):  # a kept program knows strong types only
        return function(*args)
    shapes = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves)

    def on_leaves(*leaves: Any) -> list:
        return jax.tree.leaves(function(*jax.tree.unflatten(structure, leaves)))

    path = Path(folder) / "remind-jax-programs" / _name((key, structure, shapes))
    program = _read(path)
    if program is None:
        try:
            program = export.export(jax.jit(on_leaves))(*shapes)
            _write(path, program)
        except (NotImplementedError, ValueError):
            return function(*args)
    return jax.tree.unflatten(jax.tree.structure(result), program.call(*leaves))


def is_of_this_package(function: Callable[..., Any]) -> bool:
    """Whether a function is found by its name in a module of this package."""
    module = getattr(function, "__module__", None) or ""
    name = getattr(function, "__qualname__", "<locals>")
    return module.partition(".")[0] == __name__.partition(".")[0] and "<" not in name


def name_function(function: Callable[..., Any]) -> str:
    """What tells a function of this package from all others."""
    return f"{function.__module__}.{function.__qualname__}"


def _name(key: tuple) -> str:
    settings = [jax.config.values[name] for name in sorted(jax.config.values) if _counts(name)]
    told = (jax.__version__, jax.default_backend(), *settings, key)
    return hashlib.sha256((_text_of_package() + repr(told)).encode()).hexdigest()


def _counts(name: str) -> bool:
    """Settings of JAX that a traced program may depend on."""
    return name.startswith(("jax_enable_x64", "jax_default_", "jax_numpy_", "jax_threefry"))


@functools.cache
def _text_of_package() -> str:
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(_PACKAGE)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _read(path: Path) -> export.Exported | None:
    try:
        return export.deserialize(bytearray(path.read_bytes()))
    except Exception:  # whatever a damaged file brings about
        return None


def _write(path: Path, program: export.Exported) -> None:
    """Whole or not at all, also beside other processes that write the same."""
    data = program.serialize()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(data)
        os.replace(file.name, path)
