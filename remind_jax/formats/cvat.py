"""Tracks of CVAT: the XML of video tasks, alone or in the zip that CVAT gives.

Masks, boxes and polygons are read; other shapes are refused. Between two stated frames the earlier
shape holds, and boxes go over to the later one in a straight line. Where a shape is `outside`,
nothing is there until the next one. Polygons are written, as CVAT knows no tracks of masks: of such
it keeps the first mask.
"""

from __future__ import annotations

import dataclasses
import re
import zipfile
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

import cv2
import msgspec
import numpy as np
from msgspec import Meta

from remind_jax import files
from remind_jax.crops import Crops
from remind_jax.errors import SourceError
from remind_jax.files import limits
from remind_jax.files.records import Count, Side
from remind_jax.formats.coco import Name
from remind_jax.formats.firm import firm_ids, firm_rows, main_labels
from remind_jax.formats.rows import Row, TrackRows, collect_rows
from remind_jax.frame import Rle, check_size, fill_boxes
from remind_jax.masks.run_length import decode_mask, encode_masks, encode_polygon, mask_box
from remind_jax.printing.terminal import printable
from remind_jax.tracks import Tracks

NAME_IN_ZIP = "annotations.xml"
_Pixel = Annotated[int, Meta(ge=0, le=limits.MAX_SIDE_PX)]
_Coordinate = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Frame = Annotated[int, Meta(ge=0, lt=limits.MAX_FRAMES)]
_Size = tuple[int, int]  # height and width in pixels


class _Shape(msgspec.Struct, frozen=True, kw_only=True):
    frame: _Frame
    outside: bool = False


class _Box(_Shape, frozen=True, kw_only=True):
    xtl: _Coordinate
    ytl: _Coordinate
    xbr: _Coordinate
    ybr: _Coordinate
    rotation: float = 0.0  # in degrees


class _Mask(_Shape, frozen=True, kw_only=True):
    left: _Pixel
    top: _Pixel
    width: _Pixel
    height: _Pixel
    rle: str  # runs in rows of its box: background, mask, background, ...


class _Polygon(_Shape, frozen=True, kw_only=True):  # read and written
    points: str  # "x,y;x,y;x,y"


class _Track(msgspec.Struct, frozen=True):
    id: Count
    label: Name


class _FrameSize(msgspec.Struct, frozen=True):
    height: Side
    width: Side


_SHAPES: Mapping[str, type[_Shape]] = {"box": _Box, "mask": _Mask, "polygon": _Polygon}


@dataclasses.dataclass(frozen=True)
class _Sight:
    """Where a track is in a frame: nowhere, in a box (left, top, right, bottom), or in a mask."""

    frame: int
    box: tuple[float, float, float, float] | None = None
    rle: Rle | None = None


def looks_like_cvat(path: Path) -> bool:
    """Whether a file is the XML of CVAT, or a zip that holds it."""
    if path.suffix.lower() == ".xml":
        return True
    if not zipfile.is_zipfile(path):
        return False
    with files.reading(path), zipfile.ZipFile(path) as archive:
        return NAME_IN_ZIP in archive.namelist()


def read_cvat(path: str | Path) -> TrackRows:
    """Reads the tracks of a video task as one scene.

    Raises:
      SourceError: If the file cannot be read, is no such XML, or holds impossible shapes.
    """
    path = Path(path)
    with files.reading(path):
        root = _parse(path)
        tasks = {track.get("task_id") for track in root.iter("track")}
        if len(tasks) > 1 or len(root.findall("./meta/project//task")) > 1:
            raise ValueError("it holds several tasks of a project, not one task alone")
        size = _frame_size(root)
        stated = msgspec.convert(root.findtext(".//meta//size") or "0", Count, strict=False)
        shown = _shown_frames(root)
        tracks = [_read_track(track, size, path) for track in root.iter("track")]
    if root.find("image") is not None and not tracks:
        raise SourceError(
            f"'{path}' is of CVAT for images, which has no identities; export 'CVAT for video'"
        )
    sights = [sight for _, found in tracks for sight in found if sight != _Sight(sight.frame)]
    if not (is_chosen := bool(shown) and all(sight.frame in shown for sight in sights)):
        shown = range(min(limits.MAX_FRAMES, max([stated, *(one.frame + 1 for one in sights)])))
    num_rows = sum(found[-1].frame - found[0].frame + 1 for _, found in tracks if found)
    if num_rows > limits.MAX_ROWS:
        raise SourceError(
            f"'{path}' has tracks over {num_rows} frames in all; at most {limits.MAX_ROWS} are read"
        )
    class_names = sorted({track.label for track, _ in tracks})
    has_masks = any(sight.rle is not None for sight in sights)
    if has_masks and size is None:
        raise SourceError(f"'{path}' has masks and no original_size; add it to its meta")
    rows: list[Row] = []
    for track, found in tracks:
        class_id = class_names.index(track.label)
        for sight in _fill_gaps(found):
            rle, box = sight.rle, sight.box
            if sight.frame not in shown or (rle, box) == (None, None):
                continue
            if has_masks and rle is None:
                (rle,) = encode_masks(fill_boxes(np.array([box]), size))  # pyright: ignore
            place = shown.index(sight.frame)
            rows.append((place, track.id, class_id, rle, None if has_masks else box))
    return collect_rows(
        scene_name(path),
        len(shown),
        rows,
        class_names=tuple(class_names),
        frame_size=size,
        source_frames=np.array(shown) if is_chosen else None,
    )


def scene_name(path: Path) -> str:
    """What the one scene of a file is called."""
    return path.parent.name if path.name == NAME_IN_ZIP else path.stem


def _parse(path: Path) -> ElementTree.Element:
    if path.suffix.lower() == ".xml":
        data = files.read_bytes(path, limits.MAX_XML_BYTES)
    else:
        with zipfile.ZipFile(path) as archive:
            if archive.getinfo(NAME_IN_ZIP).file_size > limits.MAX_XML_BYTES:
                raise ValueError(f"{NAME_IN_ZIP} has over {limits.MAX_XML_BYTES >> 20} MiB")
            data = archive.read(NAME_IN_ZIP)
    if b"\0" in data:
        raise ValueError("it is no text in UTF-8, as CVAT writes it")
    # CVAT declares no entities; whoever does may make them as long as memory.
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise ValueError("its DOCTYPE declares entities, which are not read")
    root = ElementTree.fromstring(data)
    if root.tag != "annotations":
        raise ValueError(f"no XML of CVAT, its root is '{root.tag[:60]}'")
    return root


def _frame_size(root: ElementTree.Element) -> _Size | None:
    """Height and width, where they are stated."""
    element = root.find(".//original_size")
    if element is None:
        return None
    said = {part.tag: part.text or "" for part in element}
    size = msgspec.convert(said, _FrameSize, strict=False)
    return check_size((size.height, size.width))


def _shown_frames(root: ElementTree.Element) -> range:
    """Numbers in the source of the frames of a task or job; none where it does not say so."""
    said = [root.findtext(f".//meta//{end}_frame") for end in ("start", "stop")]
    if not all(said):
        return range(0)
    first, last = (msgspec.convert(text, _Frame, strict=False) for text in said)
    step = re.search(r"step\s*=\s*0*([1-9]\d{0,9})", root.findtext(".//frame_filter") or "")
    return range(first, last + 1, int(step[1]) if step else 1)


def _read_track(
    element: ElementTree.Element, size: _Size | None, path: Path
) -> tuple[_Track, list[_Sight]]:
    """A track, and its stated sights by frame."""
    track = msgspec.convert(element.attrib, _Track, strict=False)
    sights = []
    for part in element:
        if part.tag == "attribute":
            continue
        place = f"track {track.id}, {part.tag} of frame {part.get('frame')}"
        with files.reading(path, place=place):
            if part.tag not in _SHAPES:
                raise ValueError(f"allowed are {', '.join(_SHAPES)}")
            shape: Any = msgspec.convert(part.attrib, _SHAPES[part.tag], strict=False)
            sights.append(_Sight(shape.frame) if shape.outside else _see(shape, size))
    return track, sorted(sights, key=lambda sight: sight.frame)


def _see(shape: Any, size: _Size | None) -> _Sight:
    if isinstance(shape, _Box):
        if shape.xbr < shape.xtl or shape.ybr < shape.ytl:
            raise ValueError("its right or lower edge comes first")
        if shape.rotation:
            raise ValueError(f"it is turned by {shape.rotation:g} degrees, as only polygons may be")
        return _Sight(shape.frame, box=(shape.xtl, shape.ytl, shape.xbr, shape.ybr))
    if size is None:
        raise ValueError("its file has no original_size in its meta")
    if isinstance(shape, _Polygon):
        points = [point.split(",") for point in shape.points.split(";")]
        corners = np.array(points, float)
        if corners.shape[1:] != (2,) or len(corners) < 3 or not (np.abs(corners) <= 1e9).all():
            raise ValueError("its points are not three or more finite ones, 'x,y;x,y;x,y'")
        return _Sight(shape.frame, rle=encode_polygon(corners, size))
    if shape.top + shape.height > size[0] or shape.left + shape.width > size[1]:
        raise ValueError(f"its box leaves the frame of {size[1]}x{size[0]} pixels")
    runs = [int(run) for run in shape.rle.split(",")]
    if min(runs) < 0 or sum(runs) != shape.width * shape.height:
        raise ValueError(f"its runs do not add up to its box, {shape.width}x{shape.height} pixels")
    inside = np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(shape.height, shape.width)
    (rle,) = encode_masks(Crops(size, ((shape.left, shape.top),), (inside,)))
    return _Sight(shape.frame, rle=rle)


def _fill_gaps(track: list[_Sight]) -> list[_Sight]:
    """The sights of every frame from the first stated one to the last."""
    filled = []
    for sight, following in zip(track, [*track[1:], None], strict=True):
        filled.append(sight)
        if following is None or sight == _Sight(sight.frame):
            continue
        for frame in range(sight.frame + 1, following.frame):
            box: Any = sight.box
            if box is not None and following.box is not None:
                share = (frame - sight.frame) / (following.frame - sight.frame)
                moved = (1 - share) * np.array(box) + share * np.array(following.box)
                box = tuple(moved.tolist())
            filled.append(dataclasses.replace(sight, frame=frame, box=box))
    return filled


def to_cvat(
    run: Sequence[Tracks], name: str, class_names: Sequence[str], frame_size: tuple[int, int]
) -> bytes:
    """CVAT for video 1.1: one track per firm identity, its outline in every processed frame.

    Its label is that of most of its sights. Where an identity is out of view, its last outline is
    marked `outside`.
    """
    root = ElementTree.Element("annotations")
    _add(root, "version", "1.1")
    task = _add(_add(root, "meta"), "task")
    numbers = [tracks.source_index for tracks in run]
    _add(task, "name", printable(name))
    steps = {*np.diff(numbers).tolist()} or {1}
    is_even = bool(numbers) and len(steps) == 1  # else outlines hold in frames passed over
    _add(task, "size", len(numbers) if is_even else max(numbers, default=-1) + 1)
    if is_even:
        _add(task, "start_frame", numbers[0])
        _add(task, "stop_frame", numbers[-1])
        _add(task, "frame_filter", f"step={steps.pop()}")
    _add(task, "mode", "interpolation")
    labels = _add(task, "labels")
    for label in class_names:
        _add(_add(labels, "label"), "name", printable(label))
    size = _add(task, "original_size")
    height, width = run[0].frame_size if run else frame_size
    _add(size, "width", width)
    _add(size, "height", height)
    label_of = main_labels(run, [*map(firm_ids, run)])
    for object_id, sights in _sights(run).items():
        named = {"id": str(object_id), "label": printable(label_of[object_id])}
        track = ElementTree.SubElement(root, "track", named, source="auto")
        for (index, row), (following, _) in pairwise([*sights, (len(run), 0)]):
            points = _outline(run[index].rles[row], (height, width))
            shape = _Polygon(frame=numbers[index], points=points)
            _add_shape(track, shape)
            if following > index + 1:
                gone = msgspec.structs.replace(shape, frame=numbers[index + 1], outside=True)
                _add_shape(track, gone)
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


def _outline(rle: Rle, frame_size: _Size) -> str:
    """One polygon around all parts of a mask and its holes, which lines there and back join.

    It is given in pixels of a frame of that size, whatever that of the mask, and runs a quarter of
    a pixel within the mask, so that the centers of its pixels are inside and no others: it is read
    as the same mask.
    """
    left, top, width, height = mask_box(rle)
    part = decode_mask(rle)[top : top + height, left : left + width]
    halves = np.repeat(np.repeat(part, 2, axis=0), 2, axis=1)
    rings, _ = cv2.findContours(halves, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    path, *others = [ring.reshape(-1, 2) for ring in rings]
    for ring in others:
        at = int(np.argmin(((path - ring[0]) ** 2).sum(axis=1)))
        path = np.concatenate([path[: at + 1], ring, ring[:1], path[at:]])
    scale = np.divide(frame_size, rle["size"])[::-1]
    corners = ((path + 0.5) / 2 + (left, top)) * scale
    return ";".join(f"{x:.2f},{y:.2f}" for x, y in corners.tolist())


def _add_shape(track: ElementTree.Element, shape: _Polygon) -> None:
    said = msgspec.structs.asdict(shape) | {"occluded": 0, "keyframe": 1, "z_order": 0}
    text = {name: str(int(v) if isinstance(v, bool) else v) for name, v in said.items()}
    ElementTree.SubElement(track, "polygon", text)


def _add(parent: ElementTree.Element, name: str, text: Any = None) -> ElementTree.Element:
    element = ElementTree.SubElement(parent, name)
    element.text = None if text is None else str(text)
    return element
