"""Memory on disk: the tracker's state as safetensors, with what is needed to go on from it."""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from remind_jax import files
from remind_jax.config import Config
from remind_jax.config.dotted_keys import flatten_fields
from remind_jax.config.keys import how_to_choose
from remind_jax.decision import Decisions, Outcome, Reason, Status
from remind_jax.errors import ConfigError, OutputError, RemindError, SourceError, first_line
from remind_jax.files.limits import MAX_LABEL
from remind_jax.files.records import check, decode_json
from remind_jax.files.tensors import TensorEntry, read_safetensors_header
from remind_jax.method import PAPER_METHOD, AtRest, Method, get_method, named_leaves
from remind_jax.numerics.absent import NO_ID
from remind_jax.numerics.array_faults import not_finite, outside, repeated
from remind_jax.session.announcement import Announcements, FiledAnnouncements
from remind_jax.session.earlier_memory import (
    EARLIER_VERSION,
    split_columns,
    with_new_leaves,
    without_decisions,
)
from remind_jax.session.object_pictures import MAX_FILE_BYTES
from remind_jax.session.object_records import FiledRecords, ObjectRecords
from remind_jax.static import Static

SCHEMA_VERSION = 8
_FORMAT = "remind-jax memory"
_GROWN = ("num_detections", "num_objects", "num_pending", "feature_dim")  # follow the frames
_BOUND = ("first_object_id", "precision")  # a memory has them from its start
_PICTURES = "pictures"  # of all objects, one after another
_AT_REST = "at_rest."  # before the names of what objects at rest are made of
_RESTORE = "restore the file, or start without it"
# As safetensors call the types of arrays.
_TYPES = {
    "bool": "BOOL",
    "uint8": "U8",
    "int32": "I32",
    "int64": "I64",
    "float32": "F32",
    "float64": "F64",
}


_CODES: dict[str, type[enum.IntEnum]] = {
    "outcome": Outcome,
    "reason": Reason,
    "status": Status,
}


@dataclasses.dataclass(frozen=True)
class SavedMemory:
    """What a memory file holds."""

    state: Any  # the memory of the method, `TrackerState` for REMIND
    static: Static
    class_names: tuple[str, ...]  # class id -> name
    backbone: str
    tracker: str = PAPER_METHOD  # name of the method
    announced: Announcements | None = None  # None: all objects, under their own ids
    records: ObjectRecords = dataclasses.field(default_factory=ObjectRecords)
    at_rest: AtRest | None = None  # objects that the state has no slots for

    def known_ids(self) -> set[int]:
        """The ids of its objects and of those that are coming to be."""
        resting = () if self.at_rest is None else self.at_rest.ids()
        return {*get_method(self.tracker).known_ids(self.state), *resting}

    def object_ids(self) -> set[int]:
        """The ids of its objects, as announced."""
        announced = self.announced or Announcements()
        return {announced.id_of(one) for one in self.known_ids()}


def save_memory(path: str | Path, memory: SavedMemory, *, durably: bool = False) -> None:
    """Writes a memory file; an existing one is replaced only by a complete one.

    Args:
      path: The file.
      memory: What it will hold.
      durably: Return only when it is on the disk, so that it outlives a power cut.
    """
    path = Path(path)
    leaves = {name: np.asarray(leaf) for name, leaf in named_leaves(memory.state)}
    if memory.at_rest is not None:
        leaves |= {f"{_AT_REST}{name}": leaf for name, leaf in memory.at_rest.tensors().items()}
    records, leaves[_PICTURES] = memory.records.to_file(memory.object_ids())
    header = {
        "format": _FORMAT,
        "schema": str(SCHEMA_VERSION),
        "static": json.dumps(dataclasses.asdict(memory.static)),
        "class_names": json.dumps(memory.class_names),
        "backbone": memory.backbone,
        "tracker": memory.tracker,
        "records": json.dumps(records),
    }
    if memory.announced is not None:
        header["announced"] = json.dumps(memory.announced.among(memory.known_ids()).to_json())
    header["sha256"] = _checksum(header, leaves)
    with files.replacing(path, SafetensorError, durably=durably) as partial:
        save_file(leaves, partial, metadata=header)


def load_memory(path: str | Path) -> SavedMemory:
    """Reads a memory file, and checks it as a whole before any of it is trusted.

    Files without a checksum, of earlier versions, are read with all other checks.

    Raises:
      OutputError: If the file is missing, damaged, no memory, of another schema version, or holds
        what no run leaves.
      ConfigError: If it was made by a tracker that there is not.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(
            f"memory '{path}' is a folder; give the file, memory.safetensors of a run"
        )
    header = read_safetensors_header(path, refused=OutputError)
    metadata = header.metadata
    if metadata.get("format") != _FORMAT:
        raise OutputError(f"'{path}' is not a memory file of remind-jax")
    schema = metadata.get("schema")
    if schema not in (str(EARLIER_VERSION), str(SCHEMA_VERSION)):
        raise OutputError(
            f"'{path}' has memory schema {schema!r}; this version reads schema {SCHEMA_VERSION}"
        )
    static, names, announced, filed = _read_description(metadata, path)
    method = get_method(metadata["tracker"])
    expected = _shape(method.name, static)
    is_earlier = schema == str(EARLIER_VERSION)
    if not is_earlier:
        _check_tensors(header.tensors, expected, path)
    try:
        tensors = load_file(path)
    except (OSError, SafetensorError) as error:
        raise OutputError(f"cannot read memory from '{path}': {first_line(error)}") from error
    checksum = metadata.get("sha256")
    if checksum is not None and checksum != _checksum(metadata, tensors):
        raise OutputError(f"'{path}' is damaged: its checksum is another one; {_RESTORE}")
    if is_earlier:
        tensors = split_columns(tensors, method.host.columns, dict(named_leaves(expected)))
        tensors = with_new_leaves(without_decisions(tensors, static), method, static)
        entries = {
            name: TensorEntry(_TYPES.get(str(one.dtype), ""), one.shape)
            for name, one in tensors.items()
        }
        _check_tensors(entries, expected, path)
    leaves = [tensors[name] for name, _ in named_leaves(expected)]
    state = jax.tree.unflatten(jax.tree.structure(expected), leaves)
    fault = find_fault(state, method, names, announced, static.first_object_id)
    if fault is not None:
        raise OutputError(f"'{path}' is damaged: {fault}; {_RESTORE}")
    try:
        records = ObjectRecords.from_file(filed, tensors[_PICTURES])
    except SourceError as error:
        raise OutputError(f"'{path}' is damaged: {error}; {_RESTORE}") from error
    at_rest = _read_at_rest(tensors, state, method, len(names), path)
    state = jax.tree.map(jax.numpy.asarray, state)
    backbone = metadata["backbone"]
    return SavedMemory(state, static, names, backbone, method.name, announced, records, at_rest)


def _read_at_rest(
    tensors: Mapping[str, np.ndarray], state: Any, method: Method, num_classes: int, path: Path
) -> AtRest | None:
    """Objects at rest beside a memory; None where the method has no place for them."""
    if method.host.at_rest is None:
        return None
    at_rest = method.host.at_rest()
    found = {
        name.removeprefix(_AT_REST): tensor
        for name, tensor in tensors.items()
        if name.startswith(_AT_REST)
    }
    try:
        for name, tensor in found.items():
            for fault in not_finite(f"{_AT_REST}{name}", tensor):
                raise ValueError(fault)
        at_rest.restore(found, state, num_classes)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise OutputError(
            f"'{path}' is damaged: its objects at rest: {first_line(error)}; {_RESTORE}"
        ) from error
    return at_rest


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


def _chosen_switches(config: Config) -> dict[str, Any]:
    """What a configuration chose of `static` beside capacities that follow the frames, by key."""
    switches = type(config.static.switches)()
    published = dict(flatten_fields(Static(switches=switches)))
    return {
        key: value
        for key, value in flatten_fields(config.static)
        if key not in _GROWN and (f"static.{key}" in config.chosen or value != published[key])
    }


def _with_switch(static: Static, key: str, value: Any) -> Static:
    """The same with another value of one key, dotted."""
    section, _, name = key.rpartition(".")
    if not section:
        return dataclasses.replace(static, **{name: value})
    switches = dataclasses.replace(static.switches, **{name: value})
    return dataclasses.replace(static, switches=switches)


def static_of(memory: SavedMemory, config: Config, path: str | Path) -> Static:
    """Capacities and structural switches to go on with: those of the memory.

    Switches that a configuration chose take their place where the memory has room for them.

    Raises:
      RemindError: If one of them asks for a memory of another shape.
    """
    static, made_with = memory.static, dict(flatten_fields(memory.static))
    for key, value in _chosen_switches(config).items():
        other = _with_switch(memory.static, key, value)
        is_bound = key in _BOUND and value != made_with[key]
        if is_bound or _shape(memory.tracker, other) != _shape(memory.tracker, memory.static):
            raise RemindError(
                f"{path} was made with static.{key} {made_with[key]}, not {value}; leave that as "
                "it was, or start without the memory"
            )
        static = _with_switch(static, key, value)
    return static


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
            "different backbones, or of frames and closeups (input.closeups), cannot be compared"
        )


def _check_tensors(tensors: Mapping[str, TensorEntry], expected: Any, path: Path) -> None:
    """Compares what the header says of the tensors with the memory that its settings make."""
    leaves = dict(named_leaves(expected))
    for name, leaf in leaves.items():
        entry = tensors.get(name)
        if entry is None or entry.shape != leaf.shape or entry.dtype != _TYPES[str(leaf.dtype)]:
            found = "missing" if entry is None else f"{entry.dtype} of shape {list(entry.shape)}"
            raise OutputError(
                f"'{path}' is damaged, or of another version: '{name}' is {found}; expected: "
                f"{_TYPES[str(leaf.dtype)]} of shape {list(leaf.shape)}"
            )
    pictures = tensors.get(_PICTURES)
    if pictures is None or pictures.dtype != "U8" or len(pictures.shape) != 1:
        raise OutputError(f"'{path}' is damaged, or of another version: it lacks '{_PICTURES}'")
    if pictures.shape[0] > MAX_FILE_BYTES:
        raise OutputError(
            f"'{path}' is damaged: it holds {pictures.shape[0]} bytes of pictures; at most "
            f"{MAX_FILE_BYTES} are kept"
        )
    for name in tensors:
        if name not in leaves and name != _PICTURES and not name.startswith(_AT_REST):
            raise OutputError(
                f"'{path}' is damaged, or of another version: it holds '{name[:100]}', which no "
                "memory of this tracker has"
            )


def _checksum(metadata: Mapping[str, str], tensors: Mapping[str, np.ndarray]) -> str:
    """Of everything in the file but the checksum itself, in any order."""
    digest = hashlib.sha256()
    described = {name: value for name, value in metadata.items() if name != "sha256"}
    digest.update(json.dumps(described, sort_keys=True).encode("ascii"))
    for name in sorted(tensors):
        array = np.ascontiguousarray(tensors[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.data if array.size else b"")
    return digest.hexdigest()


def _read_description(
    metadata: Mapping[str, str], path: Path
) -> tuple[Static, tuple[str, ...], Announcements | None, FiledRecords]:
    """Static, class names of the memory, what was announced, and records of its objects."""
    where = f"'{path}', header"
    for name in ("static", "class_names", "backbone", "tracker", "records"):
        if name not in metadata:
            raise OutputError(f"'{path}' is damaged: its header lacks '{name}'; {_RESTORE}")

    def read(name: str, record: Any) -> Any:
        data = metadata[name].encode("utf-8", "replace")
        return decode_json(data, record, f"{where}, '{name}'", refused=OutputError)

    switches = get_method(metadata["tracker"]).switches()
    values = read("static", dict[str, Any])
    if "switches" in values:
        given = values.pop("switches")
    else:  # an earlier file names the switches of the paper's tracker in every memory
        paper = {field.name for field in dataclasses.fields(get_method(PAPER_METHOD).switches())}
        earlier = {name: values.pop(name) for name in paper & set(values)}
        own = {field.name for field in dataclasses.fields(switches)}
        given = {name: value for name, value in earlier.items() if name in own}
    try:
        static = read("static", Static)
        switches = check(given, type(switches), f"{where}, 'static'", refused=OutputError)
    except ConfigError as error:
        raise OutputError(f"{where}, 'static': {error}") from error
    known = {field.name for one in (static, switches) for field in dataclasses.fields(one)}
    for name in (*values, *given):
        if name not in known:
            raise OutputError(
                f"'{path}' is damaged, or of another version: 'static' has no '{name[:100]}'"
            )
    static = dataclasses.replace(static, switches=switches)
    names = tuple(read("class_names", list[str]))
    announced = None
    if "announced" in metadata:
        announced = read("announced", FiledAnnouncements).restored()
    if static.precision == "float64" and not jax.config.read("jax_enable_x64"):
        raise OutputError(
            f"{path} was made with static.precision 'float64', which needs 64-bit JAX; set the "
            "environment variable JAX_ENABLE_X64=1"
        )
    return static, names, announced, read("records", FiledRecords)


def forget_object(memory: SavedMemory, object_id: int) -> SavedMemory:
    """The memory without an object and all that was merged into it; its records lose it as well.

    Args:
      memory: With the object.
      object_id: As announced.

    Raises:
      SourceError: If there is no such object.
      ConfigError: If the tracker cannot forget single objects.
    """
    records, announced = memory.records, memory.announced or Announcements()
    members = records.members(records.check_known(object_id))
    ids = [one for member in members for one in announced.memory_ids(member)]
    forgotten = get_method(memory.tracker).forget(memory.state, ids, memory.static)
    if memory.at_rest is not None:
        memory.at_rest.forget(ids)
    records.drop(object_id)
    return dataclasses.replace(memory, state=jax.tree.map(jax.numpy.asarray, forgotten))


def find_fault(
    state: Any,
    method: Method,
    class_names: tuple[str, ...],
    announced: Announcements | None,
    first_id: int,
) -> str | None:
    """What is wrong first, as a phrase; None if nothing is.

    Args:
      state: The memory, host arrays of the right shapes and types.
      method: Whose memory it is.
      class_names: Class names by class id.
      announced: What was announced of its objects.
      first_id: Id of the first object.
    """
    faults = _find_faults(state, class_names, first_id)
    fault = next(faults, None) or next(_of_announcements(announced, int(state.next_id)), None)
    if fault is None and method.host.find_faults is not None:
        fault = next(iter(method.host.find_faults(state)), None)
    return fault


def _find_faults(state: Any, class_names: tuple[str, ...], first_id: int) -> Iterator[str]:
    for name, leaf in named_leaves(state):
        yield from not_finite(name, leaf)
    yield from outside("frame", state.frame, 0)
    yield from outside("next_id", state.next_id, first_id)
    ids = np.asarray(state.objects.id)
    used = ids != NO_ID
    yield from outside("objects.id", ids, first_id, int(state.next_id) - 1, used)
    yield from repeated("objects.id", ids[used])
    for name in class_names:
        if not isinstance(name, str) or len(name) > MAX_LABEL:
            yield f"a class is named {str(name)[:40]!r}; allowed: up to {MAX_LABEL} characters"
    yield from repeated("class_names", np.array(class_names, object))
    if hasattr(state.objects, "class_id"):
        last_class = len(class_names) - 1
        yield from outside("objects.class_id", state.objects.class_id, 0, last_class, used)
    yield from _of_decisions(state.decisions, int(state.next_id))
    yield from outside("overflow.objects", state.overflow.objects, 0)
    yield from outside("overflow.pending", state.overflow.pending, 0)


def _of_decisions(decisions: Decisions, next_id: int) -> Iterator[str]:
    """Of the last frame; they are shown, and ids among them."""
    for name, kind in _CODES.items():
        codes = [int(code) for code in kind]
        yield from outside(f"decisions.{name}", getattr(decisions, name), min(codes), max(codes))
    for name in ("object_id", "candidate_id", "option_id"):
        values = getattr(decisions, name)
        yield from outside(f"decisions.{name}", values, NO_ID, max(next_id - 1, NO_ID))


def _of_announcements(announced: Announcements | None, next_id: int) -> Iterator[str]:
    if announced is None:
        return
    if announced.known_below < 0 or announced.next_id < 0:
        yield "what was announced counts from below 0"
    for object_id, number in announced.ids.items():
        if not (0 <= object_id < next_id and 0 <= number < announced.next_id):
            yield f"object {object_id} was announced as {number}, which cannot be"
    for object_id, count in announced.counts.items():
        if not (0 <= object_id < next_id and count >= 0):
            yield f"object {object_id} was detected {count} times, which cannot be"
