"""Metadata of a sequence: class of each annotated instance, and which frames there are.

The forms are in file_formats.md; an id mapped to null is left out on purpose.
"""

from __future__ import annotations

import dataclasses
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from remind_jax.errors import SourceError
from remind_jax.files import limits
from remind_jax.files.records import Count, decode_json
from remind_jax.sources.file_tree import read_bytes, require_inside

NUMBERED_LABEL = re.compile(r"^(.+)_\d+$")
UNNAMED_CLASS = "object"  # of what nobody names
_Id = Annotated[int, Meta(ge=0, lt=2**31)]
_Name = Annotated[str, Meta(max_length=limits.MAX_LABEL, pattern=r"\S")]  # not blank
_Labels = dict[_Id, _Name | None]  # by the id of an instance


class _Segment(msgspec.Struct, frozen=True):
    objectId: _Id | None = None
    id: _Id | None = None
    label: _Name | None = None


class _Object(msgspec.Struct, frozen=True):
    category: _Name | None = None


class _Video(msgspec.Struct, frozen=True):
    objects: dict[_Id, _Object] | None = None


class _Content(msgspec.Struct, frozen=True):
    """What is read of a metadata file; the rest of it is somebody else's."""

    default_class: _Name | None = None
    frame_names: list[Annotated[str, Meta(min_length=1, max_length=1000)]] | None = None
    frame_numbers: tuple[Count, ...] = ()
    id_to_label: _Labels | None = None
    id_to_class: _Labels | None = None
    segGroups: list[_Segment] | None = None
    videos: msgspec.Raw = msgspec.Raw()


@dataclasses.dataclass(frozen=True)
class ClassNames:
    """Class of each instance id; `file` names what to mend."""

    by_id: Mapping[int, str | None]  # None: leave this instance out
    default: str | None = None  # class of ids that are not listed
    file: str | None = None
    frame_numbers: tuple[int, ...] = ()  # in the source, of the maps by name; empty if not said

    def __contains__(self, instance_id: int) -> bool:
        return instance_id in self.by_id or self.default is not None

    def __getitem__(self, instance_id: int) -> str | None:
        return self.by_id.get(instance_id, self.default)

    def missing(self, instance_ids: Iterable[int]) -> list[int]:
        """Those ids that have no class, ascending."""
        return sorted({int(i) for i in instance_ids if int(i) not in self})


UNNAMED = ClassNames({}, default=UNNAMED_CLASS)


@dataclasses.dataclass(frozen=True)
class Metadata:
    """What a metadata file says; nothing, if there is none."""

    classes: ClassNames = UNNAMED
    frame_names: tuple[str, ...] | None = None


def find_metadata(folder: Path, candidates: Sequence[str], sequence: str) -> Metadata:
    """Reads the first candidate below a folder that speaks of instances or frames.

    Raises:
      SourceError: If that file is damaged.
    """
    for path in (folder / candidate for candidate in candidates):
        if os.path.isfile(path):
            found = parse_metadata(read_bytes(path), str(path), sequence)
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
    """What is known of the content of a metadata file. Raises SourceError if it is damaged."""
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
        labels = decode_json(msgspec.json.encode(plain), _Labels, where)
    classes = _find_classes(content, labels, file, sequence)
    return Metadata(classes or UNNAMED, tuple(names) if names else None)


def strip_number(label: str) -> str:
    """The class in a label: `game_controller_01` is a `game_controller`."""
    match = NUMBERED_LABEL.match(label.strip())
    return match.group(1) if match else label.strip()


def _find_classes(
    content: _Content, plain: _Labels | None, file: str, sequence: str
) -> ClassNames | None:
    segments: _Labels | None = None if content.segGroups is None else {}
    for number, segment in enumerate(content.segGroups or (), 1):
        instance = segment.id if segment.objectId is None else segment.objectId
        if instance is None or segments is None:
            raise SourceError(f"'{file}', `segGroups`, row {number}: `objectId` is missing")
        segments[instance] = segment.label
    by_id: dict[int, str | None] = {}
    is_found = content.default_class is not None
    for labels, convert in (
        (segments, str),
        (_labels_of_video(content, sequence, file), str),
        (content.id_to_label, strip_number),
        (content.id_to_class, str),
        (plain, strip_number),
    ):
        if labels is not None:
            is_found = True
            by_id |= {i: None if name is None else convert(name) for i, name in labels.items()}
    numbers = content.frame_numbers
    return ClassNames(by_id, content.default_class, file, numbers) if is_found else None


def _labels_of_video(content: _Content, sequence: str, file: str) -> _Labels | None:
    """Class by object id of one video of several (YouTube-VOS)."""
    if bytes(content.videos)[:1] != b"{":
        return None
    videos = decode_json(bytes(content.videos), dict[str, _Video], f"'{file}', `videos`")
    objects = videos.get(sequence, _Video()).objects
    return None if objects is None else {i: one.category for i, one in objects.items()}
