"""Compiled programs: made once per process, and once per machine where they can be kept on disk.

A program is found again by the text of this package, the versions and settings of JAX, the device,
its key, and the shapes and types of its arguments, so that results never depend on what is kept.
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import functools
import gc
import hashlib
import os
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

from remind_jax.compiled import kept
from remind_jax.compiled.compiler_options import Kind, compile_lowered, compiler_options

_PACKAGE = Path(__file__).resolve().parent.parent
_MOST_PROGRAMS = 64  # that a process holds; the least recently used one goes first

Shapes = tuple[jax.ShapeDtypeStruct, ...]


@dataclasses.dataclass(frozen=True)
class Recipe:
    """What a program is made from. Recipes are the same where key, shapes and the rest are."""

    name: str  # as profiles show it
    function: Callable[..., Any] = dataclasses.field(compare=False, repr=False)  # pure
    shapes: Shapes  # of its arguments
    # With the name it tells the function from all others; its `repr` does so between processes.
    key: Hashable
    num_donated: int = 0  # leading arguments whose buffers are used up
    kind: Kind = "step"  # by which the options of the compiler are chosen
    # Whether it may be kept on disk: its text is that of this package, and it calls no host.
    is_kept: bool = True


@dataclasses.dataclass(frozen=True)
class Program:
    """A compiled function of arrays; the answer is a list of arrays."""

    run: Callable[..., list[jax.Array]]
    outputs: Shapes
    num_bytes: int  # that it needs on a device
    structure: Any = None  # of the answer as the function gives it; None if it came from disk

    def __call__(self, *leaves: Any) -> list[jax.Array]:
        """Runs it."""
        return self.run(*leaves)


_programs: collections.OrderedDict[Hashable, Future[Program]] = collections.OrderedDict()
_lock = threading.Lock()
_waited = threading.local()
_found = threading.local()
_tracing: list[bool] = []  # whether the garbage collector ran before each trace under way


def get_program(recipe: Recipe) -> Program:
    """The program of a recipe: made before, kept on disk, or compiled now.

    Whoever asks for a program that another thread is making waits for that thread.
    """
    if is_jit_off():
        return _uncompiled(recipe)
    key = (recipe, _settings())
    with _lock:
        future = _programs.get(key)
        is_new = future is None
        if future is None:
            future = _programs[key] = Future()
            while len(_programs) > _MOST_PROGRAMS:
                _programs.popitem(last=False)
        _programs.move_to_end(key)
    if future.done():
        return future.result()
    with waiting():
        if is_new:
            try:
                future.set_result(_make(recipe))
            except BaseException as error:
                with _lock:
                    _programs.pop(key, None)
                future.set_exception(error)
                raise
        return future.result()


def _uncompiled(recipe: Recipe) -> Program:
    def run(*leaves: Any) -> list[jax.Array]:
        return jax.tree.leaves(recipe.function(*map(jnp.asarray, leaves)))

    outputs, structure = jax.tree.flatten(jax.eval_shape(recipe.function, *recipe.shapes))
    return Program(run, shapes_of(outputs), 0, structure)


def is_jit_off() -> bool:
    """Whether somebody looks into what would be compiled (`jax.disable_jit`)."""
    return jax.config.jax_disable_jit  # pyright: ignore[reportAttributeAccessIssue]


@contextlib.contextmanager
def waiting() -> Iterator[None]:
    """What passes within counts as waited for programs; not for use within itself."""
    start = time.perf_counter()
    yield
    _waited.seconds = waited_s() + time.perf_counter() - start


def waited_s() -> float:
    """Seconds that this thread has waited for programs so far."""
    return getattr(_waited, "seconds", 0.0)


def clear_programs() -> None:
    """Lets all programs of this process go; what is kept on disk stays."""
    with _lock:
        _programs.clear()


def count_bytes(compiled: jax.stages.Compiled) -> int:
    """Arguments, results and scratch space, as the compiler counts; 0 where it does not tell."""
    used = compiled.memory_analysis()
    if used is None:
        return 0
    total = used.argument_size_in_bytes + used.output_size_in_bytes + used.temp_size_in_bytes
    return int(total - used.alias_size_in_bytes)


def shapes_of(tree: Any) -> Shapes:
    """Shapes and types of the leaves of a tree, as JAX holds them."""
    return tuple(
        jax.ShapeDtypeStruct(leaf.shape, jax.dtypes.canonicalize_dtype(leaf.dtype))
        for leaf in jax.tree.leaves(tree)
    )


def keep_function(
    name: str, function: Callable[..., Any], key: Hashable, kind: Kind = "features"
) -> Callable[..., Any]:
    """A pure function from arrays to one array, compiled for every shape that it is called with.

    The text of this package and the key must tell what it does; the arguments are those of a
    `Recipe`. Within `jit` it is the function itself.
    """

    def run(*args: Any) -> Any:
        leaves, structure = jax.tree.flatten(args)
        if is_jit_off() or any(isinstance(leaf, Tracer) for leaf in leaves):
            return function(*args)

        def on_leaves(*leaves: Any) -> Any:
            return function(*jax.tree.unflatten(structure, leaves))

        recipe = Recipe(name, on_leaves, shapes_of(leaves), (key, structure), kind=kind)
        return get_program(recipe)(*leaves)[0]

    return run


def is_of_this_package(function: Callable[..., Any]) -> bool:
    """Whether a function is what is found by its name in a module of this package.

    A wrapper may have taken over the name of what it wraps.
    """
    module = getattr(function, "__module__", None) or ""
    if module.partition(".")[0] != __name__.partition(".")[0]:
        return False
    found: Any = sys.modules.get(module)
    for part in getattr(function, "__qualname__", "").split("."):
        found = getattr(found, part, None)
    return found is function


def structure_of(program: Program, recipe: Recipe) -> Any:
    """Of the answer as the function gives it, which is traced if its program came from disk."""
    if program.structure is not None:
        return program.structure
    return jax.tree.structure(jax.eval_shape(recipe.function, *recipe.shapes))


def identify(function: Callable[..., Any]) -> Hashable:
    """What tells a function from all others: its name, or itself where a name may be given again.

    A notebook defines a function of the same name anew.
    """
    if not is_of_this_package(function):
        return function
    return f"{function.__module__}.{function.__qualname__}"


def _make(recipe: Recipe) -> Program:
    file = _file_of(recipe) if recipe.is_kept else None
    if file is not None and (found := kept.load(file)) is not None:
        compiled, outputs = found
        return Program(compiled, outputs, count_bytes(compiled))
    structure = None

    def on_leaves(*leaves: Any) -> list[Any]:
        nonlocal structure
        outputs, structure = jax.tree.flatten(recipe.function(*leaves))
        return outputs

    on_leaves.__name__ = recipe.name.replace("-", "_")
    program = jax.jit(on_leaves, donate_argnums=tuple(range(recipe.num_donated)))
    with _collector_at_rest():
        lowered = program.lower(*recipe.shapes)
    found_before = _num_found_by_jax()
    compiled = compile_lowered(lowered, recipe.kind)
    outputs = shapes_of(compiled.out_info)
    # What JAX took from its own cache cannot be written again: the copy would lack functions.
    if file is not None and _num_found_by_jax() == found_before:
        kept.save(file, compiled, outputs)
    return Program(compiled, outputs, count_bytes(compiled), structure)


@contextlib.contextmanager
def _collector_at_rest() -> Iterator[None]:
    """No garbage is collected within; what was comes back when the last thread leaves.

    A trace makes millions of small objects that live until it ends; to go through all of them again
    and again would take a fifth of a start.
    """
    with _lock:
        _tracing.append(_tracing[0] if _tracing else gc.isenabled())
        gc.disable()
    try:
        yield
    finally:
        with _lock:
            ran = _tracing.pop()
            if ran and not _tracing:
                gc.enable()


def _num_found_by_jax() -> int:
    """Programs that this thread has got from JAX's own compilation cache so far."""
    _listen_to_jax()
    return getattr(_found, "number", 0)


@functools.cache
def _listen_to_jax() -> None:
    def note(event: str, **_: Any) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            _found.number = getattr(_found, "number", 0) + 1

    jax.monitoring.register_event_listener(note)


def _file_of(recipe: Recipe) -> Path | None:
    """Where the program is kept; None if nothing is."""
    folder = kept.program_folder()
    if folder is None:
        return None
    options = compiler_options(recipe.kind)
    flags = os.environ.get("XLA_FLAGS", "")
    what = (_settings(), jax.devices()[0].device_kind, flags, options, recipe)
    return folder / hashlib.sha256((_text_of_package() + repr(what)).encode()).hexdigest()


def _settings() -> tuple[Any, ...]:
    """Settings of JAX that a program may depend on."""
    values = jax.config.values
    return tuple(values[name] for name in _names_of_settings())


@functools.cache
def _names_of_settings() -> tuple[str, ...]:
    counts = ("jax_enable_x64", "jax_default_", "jax_numpy_", "jax_threefry", "jax_disable_most")
    return tuple(name for name in sorted(jax.config.values) if name.startswith(counts))


@functools.cache
def _text_of_package() -> str:
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(_PACKAGE)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
