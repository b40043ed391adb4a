"""Compiled programs on disk, so that the next process starts at once.

The environment variable `REMIND_PROGRAMS` names the folder; `off` keeps nothing. Without it they
lie in the user's cache folder. Processors, and versions of the libraries, have folders of their
own. What JAX finds in a compilation cache of its own, where one is switched on, is not kept again.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import logging
import os
import pickle
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental import serialize_executable

from remind_jax.errors import OutputError, first_line
from remind_jax.files import user_cache_folder
from remind_jax.files.sealed import read_sealed, remove_sealed, write_sealed

VARIABLE = "REMIND_PROGRAMS"
OFF = "off"
_MOST_BYTES = 1 << 30  # of one folder; files that were not used for longest are removed

_log = logging.getLogger(__name__)
_warned: set[Path] = set()  # folders of which it was said that their programs are not accepted


def program_folder() -> Path | None:
    """Where programs for this processor and these libraries are kept; None if nothing is."""
    chosen = os.environ.get(VARIABLE, "")
    if chosen.lower() == OFF:
        return None
    base = Path(chosen) if chosen else user_cache_folder() / "programs"
    return base / f"jax-{jax.__version__}-{version('jaxlib')}-{_processor()}"


def load(file: Path) -> tuple[jax.stages.Compiled, tuple[jax.ShapeDtypeStruct, ...]] | None:
    """A kept program and the shapes of its answer; None if it has to be made anew.

    What is damaged, or of another name, is removed before the library sees it. So is what the
    library does not accept, which is reported once.
    """
    content = read_sealed(file, _MOST_BYTES)
    if content is None:
        return None
    try:
        header, payload = content.split(b"\n", 1)
        head = json.loads(header)
        outputs = tuple(jax.ShapeDtypeStruct(tuple(s), d) for s, d in head["outputs"])
        in_tree = jax.tree.structure((tuple(range(head["num_arguments"])), {}))
        out_tree = jax.tree.structure(list(outputs))
        if b"lapack" in payload:
            _bind_lapack()
        # It runs on one device, as it was made; the library would take all that there are.
        with jax.ensure_compile_time_eval():
            (device,) = jax.device_put(0).devices()
        program = serialize_executable.deserialize_and_load(
            payload, in_tree, out_tree, device.client, [device]
        )
    except Exception as error:  # whatever the library says to a program of another kind
        _tell_rejected(file.parent, first_line(error))
        remove_sealed(file)
        return None
    with contextlib.suppress(OSError):
        os.utime(file)
    return program, outputs


def save(file: Path, compiled: Any, outputs: tuple[jax.ShapeDtypeStruct, ...]) -> None:
    """Keeps a program, whole or not at all, also beside other processes that write the same.

    One that the library cannot write is left out, as is one that calls the host; a folder that
    cannot be written to is left alone.
    """
    executable = getattr(compiled, "_executable", None)
    if getattr(getattr(executable, "_unloaded_executable", None), "keepalive", None):
        return  # pointers into this process
    try:
        payload, in_tree, _ = serialize_executable.serialize(compiled)
    except (ValueError, NotImplementedError, TypeError, AttributeError, pickle.PicklingError):
        return
    head = {
        "num_arguments": in_tree.num_leaves,
        "outputs": [(one.shape, str(one.dtype)) for one in outputs],
    }
    with contextlib.suppress(OSError, OutputError):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_sealed(file, json.dumps(head).encode() + b"\n" + payload)
        _remove_oldest(file.parent)


def _remove_oldest(folder: Path) -> None:
    """Keeps the folder within bounds: every change of this package makes new programs."""
    files = sorted((path.stat().st_mtime, path.stat().st_size, path) for path in folder.iterdir())
    total = sum(size for _, size, _ in files)
    for _, size, path in files:
        if total <= _MOST_BYTES:
            break
        path.unlink(missing_ok=True)
        total -= size


@functools.cache
def _bind_lapack() -> None:
    """Lets loaded programs call LAPACK, which JAX binds only when it lowers a call of it.

    That loads SciPy as well: a tenth of a second, for programs that name such a call only.
    """
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((2, 2), jnp.float32))


def _tell_rejected(folder: Path, reason: str) -> None:
    """Says so once per process."""
    if folder in _warned:
        return
    _warned.add(folder)
    _log.warning(
        "compiled programs kept in %s cannot be loaded and are made anew (%s); if this comes at "
        "every start, set %s=%s",
        folder, reason, VARIABLE, OFF,
    )  # fmt: skip


@functools.cache
def _processor() -> str:
    """A short name that differs where machine code may."""
    facts = [platform.system(), platform.machine(), platform.processor()]
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        facts += [next(line for line in lines if line.startswith(("flags", "Features")))]
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:12]
