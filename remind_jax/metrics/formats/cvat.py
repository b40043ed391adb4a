"""Truth and tracks from CVAT: the XML of video tasks, alone or in the zip that CVAT gives.

Masks, boxes and polygons of tracks are read; other shapes are refused. Between two stated frames
the earlier shape holds, as for masks in CVAT, and boxes go over to the later one in a straight
line. Where a shape is `outside`, nothing is there until the next one.
"""

from __future__ import annotations

import dataclasses
import io
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from remind_jax import files
from remind_jax.errors import SourceError
from remind_jax.files.records import MOST_LABEL
from remind_jax.frame import Rle
from remind_jax.masks.run_length import encode_masks, encode_polygon
from remind_jax.metrics.formats.rows import RowCollector, TrackRows
from remind_jax.sources.detections import fill_boxes

NAME_IN_ZIP = "annotations.xml"
_MOST_BYTES = 256 << 20  # of XML
_MOST_FRAMES = 10_000_000
_MOST_SIDE_PX = 1 << 16
_MOST_PIXELS = 1 << 28
_SHAPES = ("box", "mask", "polygon")


@dataclasses.dataclass(frozen=True)
class _Shape:
    frame: int
    is_outside: bool
    box: tuple[float, float, float, float] | None  # left, top, right, bottom; None: a mask
    rle: Rle | None


def looks_like_cvat(path: Path) -> bool:
    """Whether a file is the XML of CVAT, or a zip that holds it."""
    if path.suffix.lower() == ".xml":
        return True
    if not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return NAME_IN_ZIP in archive.namelist()


def read_cvat(path: str | Path) -> TrackRows:
    """Reads the tracks of a video task as one scene.

    Raises:
      SourceError: If the file cannot be read, is no such XML, or holds impossible shapes.
    """
    path = Path(path)
    root = _parse(_read(path), path)
    if root.tag != "annotations":
        raise SourceError(f"'{path}' is no XML of CVAT: its root is '{root.tag[:60]}'")
    if root.find("image") is not None and root.find("track") is None:
        raise SourceError(
            f"'{path}' is of CVAT for images, which has no identities; export 'CVAT for video'"
        )
    size = _frame_size(root, path)
    tracks = [_read_track(track, size, path) for track in root.iter("track")]
    stated = _whole(root.findtext(".//meta//size") or "0", 0, _MOST_FRAMES, "meta size", path)
    shapes = [shape for _, _, track in tracks for shape in track]
    num_frames = max([stated, *(shape.frame + 1 for shape in shapes if not shape.is_outside)])
    class_names = sorted({label for _, label, _ in tracks})
    has_masks = any(shape.rle is not None for shape in shapes)
    if has_masks and size is None:
        raise SourceError(f"'{path}' has masks and no original_size; add it to its meta")
    collector = RowCollector()
    for number, label, track in tracks:
        for shape in _fill_gaps(track):
            if shape.is_outside or shape.frame >= num_frames:
                continue
            rle = shape.rle
            if rle is None and has_masks:
                (rle,) = encode_masks(fill_boxes(np.array([shape.box]), size))  # pyright: ignore
            collector.add(
                shape.frame, number, class_names.index(label), rle=rle,
                box=None if has_masks else shape.box,
            )  # fmt: skip
    name = path.parent.name if path.name == NAME_IN_ZIP else path.stem
    return collector.finish(name, num_frames, class_names=class_names, frame_size=size)


def _read(path: Path) -> bytes:
    try:
        if path.suffix.lower() == ".xml":
            return files.read_bytes(path, _MOST_BYTES)
        with zipfile.ZipFile(io.BytesIO(files.read_bytes(path))) as archive:
            if archive.getinfo(NAME_IN_ZIP).file_size > _MOST_BYTES:
                raise SourceError(f"'{path}': {NAME_IN_ZIP} has over {_MOST_BYTES >> 20} MiB")
            return archive.read(NAME_IN_ZIP)
    except OSError as error:
        raise SourceError(f"cannot read '{path}': {error.strerror or error}") from error
    except (zipfile.BadZipFile, KeyError, EOFError, NotImplementedError, RuntimeError) as error:
        raise SourceError(f"'{path}' holds no {NAME_IN_ZIP} that can be read: {error}") from error


def _parse(data: bytes, path: Path) -> ElementTree.Element:
    # CVAT declares no entities; whoever does may make them as long as memory.
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise SourceError(f"'{path}' declares entities, which are not read; take the DOCTYPE out")
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SourceError(f"'{path}' is no XML: {error}") from error


def _frame_size(root: ElementTree.Element, path: Path) -> tuple[int, int] | None:
    """Height and width, where they are stated."""
    size = root.find(".//original_size")
    if size is None:
        return None
    height, width = (
        _whole(size.findtext(side) or "", 1, _MOST_SIDE_PX, f"original_size {side}", path)
        for side in ("height", "width")
    )
    if height * width > _MOST_PIXELS:
        raise SourceError(f"'{path}': frames of {width}x{height} pixels are larger than is read")
    return height, width


def _read_track(
    track: ElementTree.Element, size: tuple[int, int] | None, path: Path
) -> tuple[int, str, list[_Shape]]:
    """Id, label, and shapes by frame."""
    number = _whole(track.get("id", ""), 0, 2**31 - 1, "track id", path)
    label = track.get("label", "")
    if not 0 < len(label) <= MOST_LABEL:
        raise SourceError(
            f"'{path}', track {number}: its label has {len(label)} characters; give 1 to "
            f"{MOST_LABEL}"
        )
    shapes = []
    for element in track:
        if element.tag == "attribute":
            continue
        if element.tag not in _SHAPES:
            raise SourceError(
                f"'{path}', track {number}: shape '{element.tag[:60]}' is not read; allowed: "
                f"{', '.join(_SHAPES)}"
            )
        shapes.append(_read_shape(element, size, path, number))
    return number, label, sorted(shapes, key=lambda shape: shape.frame)


def _read_shape(
    element: ElementTree.Element, size: tuple[int, int] | None, path: Path, track: int
) -> _Shape:
    where = f"track {track}, {element.tag}"
    frame = _whole(element.get("frame", ""), 0, _MOST_FRAMES - 1, f"{where} frame", path)
    where = f"{where} of frame {frame}"
    is_outside = element.get("outside", "0") == "1"
    if element.tag == "box":
        corners = [element.get(side, "") for side in ("xtl", "ytl", "xbr", "ybr")]
        left, top, right, bottom = _numbers(corners, where, path)
        if right < left or bottom < top:
            raise SourceError(f"'{path}', {where}: its right or lower edge comes first")
        return _Shape(frame, is_outside, (left, top, right, bottom), None)
    if size is None:
        raise SourceError(f"'{path}' has a {element.tag} and no original_size; add it to its meta")
    read = _read_mask if element.tag == "mask" else _read_polygon
    return _Shape(frame, is_outside, None, read(element, size, where, path))


def _read_mask(element: ElementTree.Element, size: tuple[int, int], where: str, path: Path) -> Rle:
    left, top, width, height = (
        _whole(element.get(side, ""), 0, _MOST_SIDE_PX, f"{where} {side}", path)
        for side in ("left", "top", "width", "height")
    )
    if top + height > size[0] or left + width > size[1]:
        raise SourceError(
            f"'{path}', {where}: its box of {width}x{height} pixels at {left}, {top} leaves the "
            f"frame of {size[1]}x{size[0]}"
        )
    runs = [
        _whole(run.strip(), 0, _MOST_PIXELS, f"{where} rle", path)
        for run in element.get("rle", "").split(",")
    ]
    if sum(runs) != width * height:
        raise SourceError(
            f"'{path}', {where}: its runs have {sum(runs)} pixels and its box {width * height}"
        )
    mask = np.zeros(size, bool)
    inside = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
    mask[top : top + height, left : left + width] = inside.reshape(height, width)
    return encode_masks(mask[None])[0]


def _read_polygon(
    element: ElementTree.Element, size: tuple[int, int], where: str, path: Path
) -> Rle:
    pairs = [point.split(",") for point in element.get("points", "").split(";")]
    if len(pairs) < 3 or any(len(pair) != 2 for pair in pairs):
        raise SourceError(f"'{path}', {where}: give three or more points, 'x,y;x,y;x,y'")
    corners = _numbers([number for pair in pairs for number in pair], where, path)
    return encode_polygon(np.array(corners).reshape(-1, 2), size)


def _fill_gaps(track: list[_Shape]) -> list[_Shape]:
    """The shapes of every frame from the first stated one to the last."""
    filled = []
    for shape, following in zip(track, [*track[1:], None], strict=True):
        filled.append(shape)
        if following is None or shape.is_outside:
            continue
        for frame in range(shape.frame + 1, following.frame):
            box = shape.box
            if box is not None and following.box is not None:
                share = (frame - shape.frame) / (following.frame - shape.frame)
                moved: Float[np.ndarray, "4"] = (1 - share) * np.array(box)
                moved = moved + share * np.array(following.box)
                box = tuple(float(side) for side in moved)
            filled.append(dataclasses.replace(shape, frame=frame, box=box))
    return filled


def _whole(text: str, least: int, most: int, what: str, path: Path) -> int:
    if not (text.isascii() and text.isdecimal() and least <= int(text[:20]) <= most):
        raise SourceError(
            f"'{path}': {what} is '{text[:40]}'; give a whole number from {least} to {most}"
        )
    return int(text)


def _numbers(texts: list[Any], where: str, path: Path) -> list[float]:
    try:
        numbers = [float(text) for text in texts]
    except ValueError:
        numbers = [np.nan]
    if not (np.abs(numbers) <= 1e9).all():
        shown = ", ".join(map(str, texts))[:80]
        raise SourceError(f"'{path}', {where}: '{shown}' are not finite numbers of pixels")
    return numbers
