"""`remind memory`: who is remembered; names, and what people know better."""

from __future__ import annotations

import dataclasses
import json
import re
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from remind_jax import files
from remind_jax.cli.flags import UsageError, flags
from remind_jax.errors import OutputError
from remind_jax.printing.terminal import print_lines, print_table
from remind_jax.printing.words import listing, plural

if TYPE_CHECKING:
    from remind_jax.session.memory_file import SavedMemory
    from remind_jax.session.object_records import RememberedObject

# What can be changed, by its words.
_CHANGES = {
    "rename": 'rename ID NAME ("" takes a name back)',
    "merge": "merge ID ID ... (the others get the id of the first)",
    "split": "split ID (takes back what was merged into it)",
    "forget": "forget ID ... (with their looks and pictures)",
    "join": "join OTHER (another memory file; what both know is merged)",
}


@flags
class Memory:
    """List the objects that a memory file knows, name them, and correct who is who.

    Changes of FILE, or of a copy of it (--out):
      rename ID NAME     show this name; "" takes it back
      merge ID ID ...    the others get the id of the first
      split ID           take back what was merged into it
      forget ID ...      remove objects with their looks and pictures
      join OTHER         add the objects of another memory; what both know is merged

    Examples:
      remind memory runs/rooms
      remind memory runs/rooms/memory.safetensors rename 3 "my mug"
      remind memory kitchen.safetensors merge 3 17 -o corrected.safetensors
      remind memory runs/monday join runs/tuesday -o both.safetensors
      remind memory runs/rooms --pictures objects/
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]  # memory file, or the folder of a run
    # rename ID NAME, merge ID ID ..., split ID, forget ID ..., or join OTHER
    change: Annotated[
        Positional[tuple[str, ...]], arg(metavar="[rename|merge|split|forget|join ...]")
    ] = ()
    # where the changed memory is written; FILE itself if left out
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    pictures: Path | None = None  # folder that gets the pictures of all objects, named by their ids
    overwrite: bool = False  # replace existing files other than FILE
    json: bool = False  # print the objects as JSON
    quiet: bool = False  # say nothing but errors

    def execute(self) -> None:
        """Reads, changes, writes and lists."""
        change = _parse(self.change)
        if self.out is not None and change is None:
            raise UsageError("--out is for a changed memory; say what to change, or leave it out")
        from remind_jax.outputs.writer import CHECKPOINT_NAME, MEMORY_NAME

        def file_in(given: Path) -> Path:
            if not given.is_dir():
                return given
            inside, kept = given / MEMORY_NAME, given / CHECKPOINT_NAME / MEMORY_NAME
            return inside if inside.exists() or not kept.exists() else kept  # the run was killed

        path = file_in(self.file)
        joined = [] if change is None or change[0] != "join" else [file_in(Path(change[2]))]
        if self.out is not None:
            files.refuse_file(self.out, [path, *joined])
        for written in (self.out, self.pictures):
            if written is not None and written.exists() and not self.overwrite:
                raise OutputError(f"'{written}' exists; name another one, or allow --overwrite")
        from remind_jax.session.memory_file import MemoryFile, load_memory

        # A link to the memory in use stays one.
        file = MemoryFile(files.resolve(self.out or path), is_read=self.out is None)
        memory = load_memory(path)
        said = []
        if change is not None:
            if joined:
                memory, said = _join(memory, joined[0])
            else:
                memory, line = _apply(memory, *change)
                said = [line]
            file.update(memory)
            kept = path.parent / CHECKPOINT_NAME / MEMORY_NAME
            if self.out is None and kept.exists():
                said.append(
                    f"the run is not complete, and --resume goes on from '{kept}', without this "
                    "change; change that one too if you go on"
                )
        objects = memory.records.objects()
        about = (
            f"{plural(len(objects), 'object')} in {plural(memory.records.session, 'session')}, "
            f"tracker {memory.tracker}, {memory.backbone}"
        )
        if self.pictures is not None:
            files.make_folder(self.pictures)
            for known in objects:
                title = re.sub(r"[^\w-]+", "_", known.title)
                for number, jpeg in enumerate(known.pictures, 1):
                    name = f"{known.object_id:06d}-{number}-{title[:40]}.jpg"
                    files.replace_file(self.pictures / name, jpeg)
        if self.json:
            print(json.dumps([_facts(one) for one in objects], ensure_ascii=False, indent=1))
        elif not self.quiet:
            print_lines(*said, f"{self.out or path}: {about}")
            if change is None and objects:
                _print_objects(objects)


def _parse(words: Sequence[str]) -> tuple[str, list[int], str] | None:
    """The kind of change, ids, and name or file; None if nothing is to be changed."""
    if not words:
        return None
    kind, *rest = words
    if kind not in _CHANGES:
        ways = listing([*_CHANGES.values()], "or")
        raise UsageError(f"a memory cannot be changed by '{kind}'; give {ways}")
    num_ids = {"rename": 1, "join": 0}.get(kind, len(rest))
    ids, name = rest[:num_ids], rest[num_ids:]
    counts = {"rename": len(rest) == 2, "merge": len(rest) > 1}
    counts |= {"split": len(rest) == 1, "join": len(rest) == 1}
    are_ids = all(re.fullmatch(r"[0-9]{1,19}", word) for word in ids)
    if not counts.get(kind, len(rest) > 0) or not are_ids:
        said = reprlib.repr(" ".join(words))
        raise UsageError(f"{said} is no change of a memory; give {_CHANGES[kind]}")
    return kind, [int(word) for word in ids], "".join(name)


def _apply(
    memory: SavedMemory, kind: str, ids: Sequence[int], name: str
) -> tuple[SavedMemory, str]:
    """The changed memory, and a line about it."""
    records, first = memory.records, ids[0]
    if kind == "rename":
        records.rename(first, name)
        name = records.names.get(first, "")
        return memory, f"object {first} " + (f"is called '{name}'" if name else "has no name")
    if kind == "merge":
        records.merge(first, ids[1:])
        return memory, f"{', '.join(map(str, ids[1:]))} merged into object {first}"
    if kind == "split":
        apart = records.split(first)
        return memory, f"{', '.join(map(str, apart))} split off object {first}"
    from remind_jax.session.changed_memory import forget_object

    for object_id in ids:  # before the first goes, so that the error names what the file holds
        records.check_known(object_id)
    for object_id in dict.fromkeys(ids):
        memory = forget_object(memory, object_id)
    return memory, f"{plural(len(set(ids)), 'object')} forgotten"


def _join(memory: SavedMemory, path: Path) -> tuple[SavedMemory, list[str]]:
    """The memory with the objects of another one, and lines about who is who."""
    from remind_jax.session.changed_memory import join_memories
    from remind_jax.session.memory_file import load_memory

    memory, joined = join_memories(memory, load_memory(path), path)
    num = plural(joined.num_added, "object")
    said = [f"{num} of {path} added, {len(joined.matched)} of them known"]
    said += [f"  {gone} merged into object {kept}" for kept, gone in joined.matched]
    for one, may_be in joined.ambiguous.items():
        others = " or ".join(map(str, may_be))
        said.append(f"  object {one} may be {others}; it stays apart (merge makes them one)")
    return memory, said


def _facts(known: RememberedObject) -> dict[str, Any]:
    return {
        "id": known.object_id,
        "label": known.label,
        "name": known.name,
        "frames": known.num_frames,
        "first": dataclasses.asdict(known.first),
        "last": dataclasses.asdict(known.last),
        "merged": list(known.merged),
        "pictures": len(known.pictures),
    }


def _print_objects(objects: Sequence[RememberedObject]) -> None:
    heads = ("id", "class", "name", "frames seen", "first seen", "last seen", "merged", "pictures")
    rows = [
        (
            str(known.object_id),
            known.label,
            known.name,
            str(known.num_frames),
            str(known.first),
            str(known.last),
            ", ".join(map(str, known.merged)),
            str(len(known.pictures)),
        )
        for known in objects
    ]
    print_table([heads, *rows], is_text=(1, 2, 4, 5, 6))
