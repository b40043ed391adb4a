"""Memory on disk: the tracker's state as safetensors, with what is needed to go on from it."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import msgspec
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import save

from remind_jax import files
from remind_jax.errors import ConfigError, OutputError, RemindError, SourceError, first_line
from remind_jax.files.records import check, decode_json
from remind_jax.files.tensors import SafetensorsPart, checksum_of
from remind_jax.method import PAPER_METHOD, AtRest, Method, get_method, named_leaves
from remind_jax.numerics.array_faults import not_finite
from remind_jax.session import filed_records
from remind_jax.session.announcement import Announcements, FiledAnnouncements
from remind_jax.session.earlier_memory import as_now
from remind_jax.session.filed_records import FiledRecords
from remind_jax.session.memory_faults import find_faults
from remind_jax.session.memory_parts import (
    FORMAT,
    FORMAT_OF_CHANGES,
    RESTORE,
    SCHEMA_VERSION,
    read_parts,
)
from remind_jax.session.object_pictures import MAX_FILE_BYTES
from remind_jax.session.object_records import ObjectRecords
from remind_jax.static import Static

_PICTURES = "pictures"  # of all objects, one after another
_AT_REST = "at_rest."  # before the names of what objects at rest are made of


@dataclasses.dataclass(frozen=True)
class SavedMemory:
    """What a memory file holds."""

    state: Any  # the memory of the method, `TrackerState` for REMIND
    static: Static
    class_names: tuple[str, ...]  # class id -> name
    backbone: str
    tracker: str = PAPER_METHOD  # name of the method
    announced: Announcements = dataclasses.field(default_factory=Announcements)
    records: ObjectRecords = dataclasses.field(default_factory=ObjectRecords)
    at_rest: AtRest | None = None  # objects that the state has no slots for
    fingerprint: str = ""  # of the backbone; none is known of files of earlier versions

    def known_ids(self) -> set[int]:
        """The ids of its objects and of those that are coming to be."""
        resting = () if self.at_rest is None else self.at_rest.ids()
        return {*get_method(self.tracker).known_ids(self.state), *resting}

    def object_ids(self) -> set[int]:
        """The announced ids of its objects, and of all that people declared to be one of them."""
        return self.records.with_merged({self.announced.id_of(one) for one in self.known_ids()})


@dataclasses.dataclass(frozen=True)
class _Written:
    """What a memory file holds, so that only what changed need be added."""

    records: Mapping[int, Any]
    at_rest: Any  # of `AtRest.snapshot`
    sha256: str  # of its last part
    num_bytes: int  # of its first part, which holds everything


class MemoryFile:
    """A memory file that is brought up to date again and again, by what changed.

    Each change is added as a part of its own, until as much was added as everything takes; then the
    file is written anew. A change that was not written to its end, as by a kill, is left out.
    """

    def __init__(self, path: Path, *, is_read: bool = False) -> None:
        """`is_read`: the memory to be written comes from it."""
        self.path = path
        self._written: _Written | None = None
        # Nobody else wrote it while this is the same; None where that does not matter.
        self._found_as = _identity(path) if is_read else None

    def let_go(self) -> None:
        """Keeps no memory to compare the next one with: all of that will be written."""
        self._written = None

    def update(self, memory: SavedMemory) -> None:
        """Returns when the memory is on the disk.

        Raises:
          OutputError: If the file cannot be written, or somebody else changed it; what it held
            before is kept.
        """
        before = self._written
        if self._found_as not in (None, _identity(self.path)) and self.path.exists():
            raise OutputError(
                f"'{self.path}' was changed by another program meanwhile; load it again (or repeat "
                "the command) to go on from that, or write to another file"
            )
        # Whoever is cut off from here on wrote it last.
        self._written = self._found_as = None
        records = memory.records.kept(memory.object_ids())
        at_rest = None if memory.at_rest is None else memory.at_rest.snapshot()
        try:
            if (
                before is None
                or not self.path.exists()
                or self.path.stat().st_size > 2 * before.num_bytes
            ):
                sha256 = save_memory(self.path, memory, durably=True)
                num_bytes = self.path.stat().st_size
            else:
                leaves, header = _describe(memory, before)
                files.append_durably(self.path, save(leaves, header))
                sha256, num_bytes = header["sha256"], before.num_bytes
        finally:  # all or a part of it may be there, as of a full disk or after Ctrl-C
            self._found_as = _identity(self.path)
        self._written = _Written(records, at_rest, sha256, num_bytes)


def _identity(path: Path) -> tuple[int, int, int] | None:
    if not path.exists():
        return None
    found = path.stat()
    return found.st_ino, found.st_size, found.st_mtime_ns


def save_memory(path: Path, memory: SavedMemory, *, durably: bool = False) -> str:
    """Writes a memory file, as `files.replacing`; gives its checksum."""
    leaves, header = _describe(memory)
    with files.replacing(path, SafetensorError, durably=durably) as partial:
        partial.write_bytes(save(leaves, header))  # `save_file` lets nobody else read it
    return header["sha256"]


def _describe(
    memory: SavedMemory, before: _Written | None = None
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Arrays and metadata of a part of a memory file: everything, or what changed since."""
    leaves: dict[str, np.ndarray] = dict(named_leaves(memory.state))
    if memory.at_rest is not None:
        resting = memory.at_rest.tensors(None if before is None else before.at_rest)
        leaves |= {f"{_AT_REST}{name}": leaf for name, leaf in resting.items()}
    known = None if before is None else before.records
    records, leaves[_PICTURES] = filed_records.to_file(memory.records, memory.object_ids(), known)
    # Safetensors write the memory of an array as it lies, not its rows.
    leaves = {name: np.asarray(leaf, order="C") for name, leaf in leaves.items()}
    header = {
        "format": FORMAT if before is None else FORMAT_OF_CHANGES,
        "schema": str(SCHEMA_VERSION),
        "static": json.dumps(dataclasses.asdict(memory.static)),
        "class_names": json.dumps(memory.class_names),
        "backbone": memory.backbone,
        "tracker": memory.tracker,
        "records": _to_text(records),
    }
    if memory.fingerprint:
        header["fingerprint"] = memory.fingerprint
    if before is not None:
        header["after"] = before.sha256
    if not memory.announced.is_identity:
        header["announced"] = _to_text(memory.announced.among(memory.known_ids()).filed())
    header["sha256"] = checksum_of(header, leaves)
    return leaves, header


def _to_text(record: msgspec.Struct) -> str:
    return msgspec.json.encode(record).decode()


def load_memory(path: str | Path) -> SavedMemory:
    """Reads a memory file, and checks it as a whole before any of it is trusted.

    Files without a checksum, of earlier versions, are read with all other checks.

    Raises:
      OutputError: If the file is missing, damaged, no memory, of another schema version, or holds
        what no run leaves.
      ConfigError: If it was made by a tracker that there is not.
    """
    path = files.as_path(path, "the memory file", OutputError)
    if path.is_dir():
        raise OutputError(
            f"memory '{path}' is a folder; give the file, memory.safetensors of a run"
        )
    parts = read_parts(path)
    metadata, tensors = parts[-1].metadata, parts[-1].tensors
    static, names, announced, _ = _read_description(metadata, path)
    method = get_method(metadata["tracker"])
    expected = shape_of(method.name, static)
    leaves = dict(named_leaves(expected))
    tensors = as_now(tensors, metadata["schema"], method, static, leaves)
    _check_tensors(tensors, leaves, path)
    state = jax.tree.unflatten(jax.tree.structure(expected), [tensors[name] for name in leaves])
    for fault in find_faults(state, method, names, announced, static.first_object_id):
        raise OutputError(f"'{path}' is damaged: {fault}; {RESTORE}")
    try:
        records = filed_records.from_file(
            [(_read_description(one.metadata, path)[3], _pictures(one, path)) for one in parts]
        )
    except SourceError as error:
        raise OutputError(f"'{path}' is damaged: {error}; {RESTORE}") from error
    at_rest = _read_at_rest(parts, state, method, len(names), path)
    state = jax.device_put(state)
    return SavedMemory(
        state,
        static,
        names,
        metadata["backbone"],
        method.name,
        announced,
        records,
        at_rest,
        metadata.get("fingerprint", ""),
    )


def _pictures(part: SafetensorsPart, path: Path) -> np.ndarray:
    """The bytes of all pictures of a part."""
    pictures = part.tensors.get(_PICTURES)
    if pictures is None or pictures.dtype != np.uint8 or pictures.ndim != 1:
        raise OutputError(f"'{path}' is damaged, or of another version: it lacks '{_PICTURES}'")
    if len(pictures) > MAX_FILE_BYTES:
        raise OutputError(
            f"'{path}' is damaged: it holds {len(pictures)} bytes of pictures; at most "
            f"{MAX_FILE_BYTES} are kept"
        )
    return pictures


def _read_at_rest(
    parts: Sequence[SafetensorsPart], state: Any, method: Method, num_classes: int, path: Path
) -> AtRest | None:
    """Objects at rest beside a memory; None where the method has no place for them."""
    if method.host.at_rest is None:
        return None
    at_rest = method.host.at_rest()
    found = [
        {
            name.removeprefix(_AT_REST): tensor
            for name, tensor in part.tensors.items()
            if name.startswith(_AT_REST)
        }
        for part in parts
    ]
    try:
        for one in found:
            for name, tensor in one.items():
                for fault in not_finite(f"{_AT_REST}{name}", tensor):
                    raise ValueError(fault)
        at_rest.restore(found, state, num_classes)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise OutputError(
            f"'{path}' is damaged: its objects at rest: {first_line(error)}; {RESTORE}"
        ) from error
    return at_rest


def check_precision(static: Static, said: str, refused: type[RemindError]) -> None:
    """Refuses numbers of 64 bits, which `said` tells who wants, where JAX computes in 32."""
    if static.precision == "float64" and not jax.config.read("jax_enable_x64"):
        raise refused(
            f"{said} static.precision 'float64', which needs 64-bit JAX; set the environment "
            "variable JAX_ENABLE_X64=1"
        )


def shape_of(tracker: str, static: Static) -> Any:
    """Shapes and types of the memory of a method."""
    return jax.eval_shape(functools.partial(get_method(tracker).init, static))


def _check_tensors(
    tensors: Mapping[str, np.ndarray], leaves: Mapping[str, Any], path: Path
) -> None:
    """Compares arrays of a file with the memory that its settings make."""
    for name, leaf in leaves.items():
        own = tensors.get(name)
        if own is None or own.shape != leaf.shape or own.dtype != leaf.dtype:
            found = "missing" if own is None else f"{_type(own)} of shape {list(own.shape)}"
            raise OutputError(
                f"'{path}' is damaged, or of another version: '{name}' is {found}; expected: "
                f"{_type(leaf)} of shape {list(leaf.shape)}"
            )
    for name in tensors:
        if name not in leaves and name != _PICTURES and not name.startswith(_AT_REST):
            raise OutputError(
                f"'{path}' is damaged, or of another version: it holds '{name[:100]}', which no "
                "memory of this tracker has"
            )


def _type(array: Any) -> str:
    """As safetensors call it: F32."""
    return f"{str(array.dtype)[0].upper()}{8 * array.dtype.itemsize}"


def _read_description(
    metadata: Mapping[str, str], path: Path
) -> tuple[Static, tuple[str, ...], Announcements, FiledRecords]:
    """Static, class names of the memory, what was announced, and records of its objects."""
    where = f"'{path}', header"
    for name in ("static", "class_names", "backbone", "tracker", "records"):
        if name not in metadata:
            raise OutputError(f"'{path}' is damaged: its header lacks '{name}'; {RESTORE}")

    def read(name: str, record: Any) -> Any:
        data = metadata[name].encode("utf-8", "replace")
        return decode_json(data, record, f"{where}, '{name}'", refused=OutputError)

    try:
        switches = get_method(metadata["tracker"]).switches()
    except ConfigError as error:
        raise ConfigError(f"'{path}': {error}; register one of your own before") from error
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
    announced = Announcements()
    if "announced" in metadata:
        announced = read("announced", FiledAnnouncements).restored()
    check_precision(static, f"{path} was made with", OutputError)
    return static, names, announced, read("records", FiledRecords)
