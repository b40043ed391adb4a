"""Metadata of a sequence: class of each annotated instance, and which frames there are.

The forms are in file_formats.md; an id mapped to null is left out on purpose.
"""

from __future__ import annotations

import dataclasses
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Optional

import msgspec
from msgspec import Meta

from remind_jax.errors import SourceError
from remind_jax.files.records import Count, Label, decode_json, decode_rows
from remind_jax.sources.file_tree import FileTree, read_bytes, require_inside
from remind_jax.sources.source import UnreadableFrame

_Labels = dict[str, msgspec.Raw]  # by the id of an instance
_MaybeLabel: Any = Optional[Label]  # noqa: UP045  (one kind, as a value)
NUMBERED_LABEL = re.compile(r"^(.+)_\d+$")
ANY_CLASS = "object"


class _Content(msgspec.Struct, frozen=True):
    """What is read of a metadata file; the rest of it is somebody else's."""

    default_class: Label | None = None
    frame_names: list[Annotated[str, Meta(min_length=1, max_length=1000)]] | None = None
    id_to_label: dict[str, msgspec.Raw] | None = None
    id_to_class: dict[str, msgspec.Raw] | None = None
    segGroups: list[msgspec.Raw] | None = None
    videos: msgspec.Raw = msgspec.Raw()


class _Segment(msgspec.Struct, frozen=True):
    objectId: Count | None = None
    id: Count | None = None
    label: Label | None = None


class _Object(msgspec.Struct, frozen=True):
    category: Label | None = None


class _Video(msgspec.Struct, frozen=True):
    objects: dict[str, _Object] | None = None


@dataclasses.dataclass(frozen=True)
class ClassNames:
    """Class of each instance id; `file` names what to mend."""

    by_id: Mapping[int, str | None]  # None: leave this instance out
    default: str | None = None  # class of ids that are not listed
    file: str | None = None

    def __contains__(self, instance_id: int) -> bool:
        return instance_id in self.by_id or self.default is not None

    def __getitem__(self, instance_id: int) -> str | None:
        return self.by_id.get(instance_id, self.default)

    def missing(self, instance_ids: Iterable[int]) -> list[int]:
        """Those ids that have no class, ascending."""
        return sorted({int(i) for i in instance_ids if int(i) not in self})


UNNAMED = ClassNames({}, default=ANY_CLASS)


@dataclasses.dataclass(frozen=True)
class Metadata:
    """What a metadata file says; nothing, if there is none."""

    classes: ClassNames = UNNAMED
    frame_names: tuple[str, ...] | None = None


def find_metadata(tree: FileTree, candidates: Sequence[str], sequence: str) -> Metadata:
    """Reads the first candidate that speaks of instances or frames.

    Raises:
      SourceError: If that file is damaged.
    """
    for path in candidates:
        if tree.has_file(path):
            try:
                data = tree.read(path)
            except UnreadableFrame as error:
                raise SourceError(f"'{tree.locate(path)}' {error}") from error
            found = parse_metadata(data, tree.locate(path), sequence)
            if found != Metadata():
                return found
    return Metadata()


def read_metadata(path: Path, sequence: str) -> Metadata:
    """Reads a metadata file that was named.

    Raises:
      SourceError: If it cannot be read, or says nothing about classes.
    """
    found = parse_metadata(read_bytes(path), str(path), sequence)
    if found.classes is UNNAMED:
        raise SourceError(
            f"metadata '{path}' maps no instance ids to classes; give it 'id_to_class' or "
            '\'id_to_label\', for instance {"id_to_label": {"1": "cup_01"}}'
        )
    return found


def parse_metadata(data: bytes, file: str, sequence: str) -> Metadata:
    """Takes what is known out of the content of a metadata file.

    Raises:
      SourceError: If it is damaged.
    """
    where = f"'{file}'"
    parts = decode_json(data, dict[str, msgspec.Raw], where)
    content = decode_json(data, _Content, where)
    names = content.frame_names or None
    for name in names or ():
        require_inside(name, f"`frame_names` of {where}")
    if names and len(set(names)) < len(names):
        twice, _ = Counter(names).most_common(1)[0]
        raise SourceError(f"{where}, `frame_names`: '{twice}' stands twice; name every frame once")
    plain = {key: value for key, value in parts.items() if key != "default_class"}
    labels: _Labels | None = None
    if plain and all(key.isascii() and key.isdecimal() for key in plain):
        labels = plain
    classes = _find_classes(content, labels, file, sequence)
    return Metadata(classes or UNNAMED, tuple(names) if names else None)


def strip_number(label: str) -> str:
    """The class in a label: `game_controller_01` is a `game_controller`."""
    match = NUMBERED_LABEL.match(label.strip())
    return match.group(1) if match else label.strip()


def _find_classes(
    content: _Content, plain: _Labels | None, file: str, sequence: str
) -> ClassNames | None:
    where = f"'{file}'"
    by_id: dict[int, str | None] = {}
    is_found = content.default_class is not None
    if content.segGroups is not None:
        is_found = True
        for row in decode_rows(content.segGroups, _Segment, f"{where}, `segGroups`"):
            segment = row.get()
            number = segment.id if segment.objectId is None else segment.objectId
            if number is None:
                raise SourceError(f"{where}, `segGroups`, row {row.number}: `objectId` is missing")
            by_id[number] = _class_in(segment.label, str, f"{where}, instance {number}")
    for entries, convert in (
        (_labels_of_video(content, sequence, where), str),
        (content.id_to_label, strip_number),
        (content.id_to_class, str),
        (plain, strip_number),
    ):
        if entries is not None:
            is_found = True
            by_id.update(_classes_by_id(entries, convert, where))
    if content.default_class is not None and not content.default_class.strip():
        raise SourceError(f"{where}, `default_class` is empty; give a class name")
    return ClassNames(by_id, content.default_class, file) if is_found else None


def _labels_of_video(content: _Content, sequence: str, where: str) -> _Labels | None:
    """Class by object id of one video of several (YouTube-VOS)."""
    if bytes(content.videos)[:1] != b"{":
        return None
    videos = decode_json(bytes(content.videos), dict[str, msgspec.Raw], f"{where}, `videos`")
    if sequence not in videos:
        return None
    place = f"{where}, `videos.{sequence[:40]}`"
    objects = decode_json(bytes(videos[sequence]), _Video, place).objects
    if objects is None:
        return None
    return {i: msgspec.Raw(msgspec.json.encode(found.category)) for i, found in objects.items()}


def _classes_by_id(
    labels: _Labels, convert: Callable[[str], str], where: str
) -> dict[int, str | None]:
    classes: dict[int, str | None] = {}
    for key, raw in labels.items():
        number = int(key) if re.fullmatch(r"\s*[0-9]{1,10}\s*", key) else -1
        if not 0 <= number < 2**31:
            raise SourceError(
                f"{where}: instance id {key[:40]!r} is not a whole number from 0 to {2**31 - 1}"
            )
        place = f"{where}, instance {number}"
        if number in classes:
            raise SourceError(f"{place}: it stands twice; give it one class")
        classes[number] = _class_in(decode_json(bytes(raw), _MaybeLabel, place), convert, place)
    return classes


def _class_in(label: str | None, convert: Callable[[str], str], place: str) -> str | None:
    if label is None:
        return None
    if not label.strip():
        raise SourceError(
            f"{place}: its class is {label!r}; give a name, or null to leave the instance out"
        )
    return convert(label)
