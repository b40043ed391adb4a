"""A run for labeling tools: CVAT for video, and instance maps in the DAVIS layout.

As in `tables`, they know firm identities only, each once per frame. Frames are those of the source.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np

from remind_jax import files
from remind_jax.decision import NO_ID
from remind_jax.errors import OutputError
from remind_jax.masks.run_length import decode_mask, mask_box
from remind_jax.outputs.result import Result
from remind_jax.outputs.tables import firm_rows, masks_without_overlap
from remind_jax.printing.terminal import printable
from remind_jax.tracks import Tracks

METADATA_NAME = "metadata.json"
_MAX_8_BIT = 254  # 255 is void in 8-bit truth


def write_cvat(result: Result, path: str | Path) -> None:
    """Writes a run as CVAT for video 1.1; a file that is there is replaced."""
    files.replace_file(Path(path), to_cvat(result))


def to_cvat(result: Result) -> bytes:
    """CVAT for video 1.1: one track per identity with its mask in every processed frame.

    In between, a mask holds. Where an identity is out of view, its last mask is marked `outside`.
    """
    root = ElementTree.Element("annotations")
    _add(root, "version", "1.1")
    task = _add(_add(root, "meta"), "task")
    height, width = _frame_size(result)
    _add(task, "name", printable(result.info.name))
    numbers = [tracks.source_index for tracks in result.tracks]
    _add(task, "size", max(numbers, default=-1) + 1)
    _add(task, "mode", "interpolation")
    labels = _add(task, "labels")
    for name in result.class_names:
        _add(_add(labels, "label"), "name", printable(name))
    size = _add(task, "original_size")
    _add(size, "width", width)
    _add(size, "height", height)
    for object_id, sights in _sights(result.tracks).items():
        first, row = sights[0]
        label = printable(result.tracks[first].labels[row])
        track = ElementTree.SubElement(
            root, "track", id=str(object_id), label=label, source="automatic"
        )
        for place, (index, row) in enumerate(sights):
            shape = _cvat_mask(result.tracks[index], row)
            following = sights[place + 1][0] if place + 1 < len(sights) else len(result.tracks)
            ElementTree.SubElement(
                track, "mask", {"frame": str(numbers[index]), "outside": "0", **shape}
            )
            if following > index + 1:
                end = str(numbers[index + 1])
                ElementTree.SubElement(track, "mask", {"frame": end, "outside": "1", **shape})
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _sights(run: Sequence[Tracks]) -> dict[int, list[tuple[int, int]]]:
    """Frame and row of every sight of each identity, by rising id."""
    sights: dict[int, list[tuple[int, int]]] = {}
    for index, tracks in enumerate(run):
        for row in firm_rows(tracks):
            if tracks.areas[row]:
                sights.setdefault(int(tracks.object_id[row]), []).append((index, int(row)))
    return dict(sorted(sights.items()))


def _cvat_mask(tracks: Tracks, row: int) -> dict[str, str]:
    """A mask as CVAT writes it: runs over the rows of its box, the first one background."""
    left, top, width, height = mask_box(tracks.rles[row])
    part = decode_mask(tracks.rles[row])[top : top + height, left : left + width].ravel()
    changes = np.flatnonzero(np.diff(part, prepend=0))
    runs = np.diff(changes, prepend=0, append=part.size)
    return {
        "occluded": "0",
        "keyframe": "1",
        "rle": ", ".join(map(str, runs)),
        "left": str(left),
        "top": str(top),
        "width": str(width),
        "height": str(height),
        "z_order": "0",
    }


def picture_names(run: Sequence[Tracks]) -> list[str]:
    """Names of pictures without suffix, that sort as the frames do: those of the source if so."""
    names = [printable(PurePath(tracks.name).stem) for tracks in run]
    if sorted(set(names)) == names:
        return names
    return [f"{tracks.source_index:06d}" for tracks in run]


def _frame_size(result: Result) -> tuple[int, int]:
    return result.tracks[0].frame_size if result.tracks else result.info.frame_size or (0, 0)


def _add(parent: ElementTree.Element, name: str, text: Any = None) -> ElementTree.Element:
    element = ElementTree.SubElement(parent, name)
    element.text = None if text is None else str(text)
    return element


def write_instance_maps(result: Result, folder: str | Path) -> None:
    """Writes the firm identities of a run; shared pixels go to the higher confidence.

    The maps come to be all at once, or none.

    Raises:
      OutputError: If an identity is beyond 16 bits, something else lies where the maps go, or the
        folder cannot be written.
    """
    name = PurePath(printable(result.info.name)).name or "run"
    maps = Path(folder) / "Annotations" / name
    classes = {
        int(tracks.object_id[row]) + 1: printable(tracks.labels[row])
        for tracks in result.tracks
        for row in np.flatnonzero(tracks.object_id != NO_ID)
    }
    most = max(classes, default=0)
    if most > np.iinfo(np.uint16).max:
        raise OutputError(
            f"identity {most - 1} does not fit into instance maps of 16 bits; write cvat instead"
        )
    pictures = [f"{picture}.png" for picture in picture_names(result.tracks)]
    others = {path.name for path in maps.iterdir()} - set(pictures) if maps.is_dir() else set()
    if others:
        raise OutputError(
            f"'{maps}' holds '{min(others)}', which is no map of this run; name another folder"
        )
    dtype = np.uint8 if most <= _MAX_8_BIT else np.uint16
    with files.replacing_folder(maps, Path(folder)) as unfinished:
        for tracks, picture in zip(result.tracks, pictures, strict=True):
            (unfinished / picture).write_bytes(_draw(tracks, dtype))
        content = {"sequence": name, "id_to_class": {str(k): v for k, v in sorted(classes.items())}}
        text = json.dumps(content, ensure_ascii=False, indent=1) + "\n"
        files.replace_file(Path(folder) / METADATA_NAME, text.encode("utf-8"))


def _draw(tracks: Tracks, dtype: type[np.unsignedinteger]) -> bytes:
    """The map of a frame as a PNG."""
    drawn = np.zeros(tracks.frame_size, dtype)
    rows = firm_rows(tracks)
    for row, rle in zip(rows, masks_without_overlap(tracks, rows), strict=True):
        if rle is not None:
            drawn[decode_mask(rle).astype(bool)] = int(tracks.object_id[row]) + 1
    return cv2.imencode(".png", drawn)[1].tobytes()
