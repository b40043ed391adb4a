"""Metadata of a sequence: which class an annotated instance has, and which frames there are.

Recognized, in this order: `id_to_class` (id to class), `id_to_label` (id to a label such as
`chair_3`, whose number is cut off), YouTube-VOS `meta.json` (`videos/<sequence>/objects`),
ScanNet++ `segments_anno.json` (`segGroups`), or a plain object of ids and labels. An id mapped to
null is left out of the sequence on purpose; `default_class` serves all ids that are not listed.
`frame_names` lists the image files in order; in annotations `frame_000012.png` the number is then
the place in this list.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from remind_jax.errors import SourceError
from remind_jax.sources.file_tree import FileTree, read_bytes

NUMBERED_LABEL = re.compile(r"^(.+)_\d+$")
ANY_CLASS = "object"


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
            found = parse_metadata(tree.read(path), tree.locate(path), sequence)
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

    Args:
      data: The content, JSON.
      file: Its name for messages.
      sequence: Which sequence of a file that holds several (YouTube-VOS).

    Raises:
      SourceError: If it is damaged.
    """
    content = _parse_object(data, file)
    names = content.get("frame_names") or None
    if names is not None and not (
        isinstance(names, list) and all(isinstance(name, str) for name in names)
    ):
        raise SourceError(f"'frame_names' in '{file}' is not a list of file names")
    classes = _find_classes(content, file, sequence)
    return Metadata(classes or UNNAMED, tuple(names) if names else None)


def strip_number(label: str) -> str:
    """The class in a label: `game_controller_01` is a `game_controller`."""
    match = NUMBERED_LABEL.match(label.strip())
    return match.group(1) if match else label.strip()


def _find_classes(content: dict[str, Any], file: str, sequence: str) -> ClassNames | None:
    default = content.get("default_class")
    if default is not None and not isinstance(default, str):
        raise SourceError(f"'default_class' in '{file}' is {default!r}; give a class name")
    by_id: dict[int, str | None] = {}
    is_found = default is not None
    for entries, convert in (
        (_segment_labels(content), str),
        (_video_objects(content, sequence), str),
        (content.get("id_to_label"), strip_number),
        (content.get("id_to_class"), str),
        (content if _is_plain_map(content) else None, strip_number),
    ):
        if isinstance(entries, Mapping):
            is_found = True
            by_id.update(_classes_by_id(entries, convert, file))
    return ClassNames(by_id, default, file) if is_found else None


def _parse_object(data: bytes, file: str) -> dict[str, Any]:
    try:
        metadata = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise SourceError(f"metadata '{file}' is not valid JSON: {error}") from error
    if not isinstance(metadata, dict):
        raise SourceError(
            f"metadata '{file}' is a JSON {type(metadata).__name__}; it must be an object"
        )
    return metadata


def _classes_by_id(
    entries: Mapping[Any, Any], convert: Callable[[str], str], file: str
) -> dict[int, str | None]:
    classes: dict[int, str | None] = {}
    for key, label in entries.items():
        if not re.fullmatch(r"\s*\d+\s*", str(key)):
            raise SourceError(f"instance id {key!r} in '{file}' is not a whole number")
        if label is not None and (not isinstance(label, str) or not label.strip()):
            raise SourceError(
                f"instance {key} in '{file}' has the class {label!r}; give a name, or null to "
                "leave the instance out"
            )
        classes[int(key)] = None if label is None else convert(label)
    return classes


def _is_plain_map(metadata: Mapping[str, Any]) -> bool:
    return bool(metadata) and all(str(k).isdecimal() for k in metadata if k != "default_class")


def _video_objects(metadata: Mapping[str, Any], sequence: str) -> dict[Any, Any] | None:
    videos = metadata.get("videos")
    video = videos.get(sequence) if isinstance(videos, Mapping) else None
    objects = video.get("objects") if isinstance(video, Mapping) else None
    if not isinstance(objects, Mapping):
        return None
    return {k: o.get("category") for k, o in objects.items() if isinstance(o, Mapping)}


def _segment_labels(metadata: Mapping[str, Any]) -> dict[Any, Any] | None:
    groups = metadata.get("segGroups")
    if not isinstance(groups, list):
        return None
    groups = [g for g in groups if isinstance(g, Mapping)]
    return {g.get("objectId", g.get("id")): g.get("label") for g in groups}
