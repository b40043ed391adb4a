"""Memory on disk: the tracker's state as safetensors, with what is needed to go on from it."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
from pathlib import Path
from typing import Any

import jax
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from remind_jax import files
from remind_jax.config import Config
from remind_jax.config.keys import how_to_choose
from remind_jax.errors import OutputError, RemindError
from remind_jax.method import PAPER_METHOD, get_method, named_leaves
from remind_jax.session.announcement import Announcements
from remind_jax.static import Static

SCHEMA_VERSION = 2
_FORMAT = "remind-jax memory"
_GROWN = ("num_detections", "num_objects", "num_pending", "feature_dim")  # follow the frames
_BOUND = ("first_object_id", "precision")  # a memory has them from its start
_PUBLISHED = Static()


@dataclasses.dataclass(frozen=True)
class SavedMemory:
    """What a memory file holds."""

    state: Any  # the memory of the method, `TrackerState` for REMIND
    static: Static
    class_names: tuple[str, ...]  # class id -> name
    backbone: str
    tracker: str = PAPER_METHOD  # name of the method
    announced: Announcements | None = None  # None: all objects, under their own ids


def save_memory(path: str | Path, memory: SavedMemory) -> None:
    """Writes a memory file; an existing one is replaced only by a complete one.

    Raises:
      OutputError: If the file cannot be written.
    """
    path = Path(path)
    leaves = {name: np.asarray(leaf) for name, leaf in named_leaves(memory.state)}
    header = {
        "format": _FORMAT,
        "schema": str(SCHEMA_VERSION),
        "static": json.dumps(dataclasses.asdict(memory.static)),
        "class_names": json.dumps(memory.class_names),
        "backbone": memory.backbone,
        "tracker": memory.tracker,
    }
    if memory.announced is not None:
        header["announced"] = json.dumps(memory.announced.to_json())
    unfinished = path.with_name(path.name + ".part")
    try:
        save_file(leaves, unfinished, metadata=header)
        os.replace(unfinished, path)
    except (OSError, SafetensorError) as error:
        unfinished.unlink(missing_ok=True)
        raise OutputError(f"cannot write memory to {path}: {error}") from error


def load_memory(path: str | Path) -> SavedMemory:
    """Reads a memory file.

    Raises:
      OutputError: If the file is missing, damaged, no memory, or of another schema version.
      ConfigError: If it was made by a tracker that there is not.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(
            f"memory '{path}' is a folder; give the file, memory.safetensors of a run"
        )
    try:
        files.check_regular(path)
        header = _read_header(path)
        tensors = load_file(path)
    except (OSError, SafetensorError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"cannot read memory from {path}: {reason}") from error
    if header.get("format") != _FORMAT:
        raise OutputError(f"{path} is not a memory file of remind-jax")
    if header.get("schema") != str(SCHEMA_VERSION):
        raise OutputError(
            f"{path} has memory schema {header.get('schema')}; this version reads schema "
            f"{SCHEMA_VERSION}"
        )
    static, names, backbone, tracker, announced = _read_description(header, path)
    empty = get_method(tracker).init(static)
    leaves = []
    for name, leaf in named_leaves(empty):
        if name not in tensors or tensors[name].shape != leaf.shape:
            raise OutputError(f"{path} is damaged: '{name}' is missing or of another shape")
        leaves.append(jax.numpy.asarray(tensors[name], leaf.dtype))
    state = jax.tree.unflatten(jax.tree.structure(empty), leaves)
    return SavedMemory(state, static, names, backbone, tracker, announced)


def check_tracker(memory: SavedMemory, tracker: str, path: str | Path) -> None:
    """Refuses the memory of another tracker.

    Raises:
      RemindError: If the trackers differ.
    """
    if memory.tracker != tracker:
        raise RemindError(
            f"{path} is the memory of tracker '{memory.tracker}', not '{tracker}'; go on with "
            f"{how_to_choose(memory.tracker)}"
        )


def chosen_switches(config: Config) -> dict[str, Any]:
    """What a configuration chose of `static` beside capacities that follow the frames."""
    return {
        name: value
        for name, value in dataclasses.asdict(config.static).items()
        if name not in _GROWN
        and (f"static.{name}" in config.chosen or value != getattr(_PUBLISHED, name))
    }


def static_of(memory: SavedMemory, config: Config, path: str | Path) -> Static:
    """Capacities and structural switches to go on with: those of the memory.

    Switches that a configuration chose take their place where the memory has room for them.

    Raises:
      RemindError: If one of them asks for a memory of another shape.
    """
    asked = chosen_switches(config)
    for name, value in asked.items():
        made_with = getattr(memory.static, name)
        other = dataclasses.replace(memory.static, **{name: value})
        is_bound = name in _BOUND and value != made_with
        if is_bound or _shape(memory.tracker, other) != _shape(memory.tracker, memory.static):
            raise RemindError(
                f"{path} was made with static.{name} {made_with}, not {value}; leave that as it "
                "was, or start without the memory"
            )
    return dataclasses.replace(memory.static, **asked)


def _shape(tracker: str, static: Static) -> Any:
    """Shapes and types of the memory of a method."""
    return jax.eval_shape(functools.partial(get_method(tracker).init, static))


def check_backbone(memory: SavedMemory, backbone: str, path: str | Path) -> None:
    """Refuses features that the memory was not made with.

    Raises:
      RemindError: If the backbones differ.
    """
    if memory.backbone != backbone:
        raise RemindError(
            f"{path} was made with backbone '{memory.backbone}', not '{backbone}'; features of "
            "different backbones cannot be compared"
        )


def _read_header(path: Path) -> dict[str, str]:
    """The metadata of a safetensors file: a length and a JSON object at its start."""
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        if not 0 < length <= 1 << 26:
            raise OSError("it is not a safetensors file")
        header = json.loads(file.read(length))
        metadata = header.get("__metadata__", {}) if isinstance(header, dict) else {}
        return metadata if isinstance(metadata, dict) else {}


def _read_description(
    header: dict[str, str], path: Path
) -> tuple[Static, tuple[str, ...], str, str, Announcements | None]:
    """Static, class names, backbone and tracker of the memory, and what was announced."""
    try:
        values: Any = json.loads(header["static"])
        values = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
        static = Static(**values)
        names = tuple(json.loads(header["class_names"]))
        backbone, tracker = header["backbone"], header["tracker"]
        text = header.get("announced")
        announced = None if text is None else Announcements.from_json(json.loads(text))
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise OutputError(f"{path} is damaged: its description cannot be read ({error})") from error
    if static.precision == "float64" and not jax.config.read("jax_enable_x64"):
        raise OutputError(
            f"{path} was made with static.precision 'float64', which needs 64-bit JAX; set the "
            "environment variable JAX_ENABLE_X64=1"
        )
    return static, names, backbone, tracker, announced
