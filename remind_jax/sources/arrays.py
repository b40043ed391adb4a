"""Frames that are already in memory, or come from any Python iterable."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence, Sized
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from remind_jax.errors import SourceError
from remind_jax.files.host_array import host_array
from remind_jax.formats.pictures import decode_image
from remind_jax.frame import UNTIMED_FPS, Detections, Frame, check_frame
from remind_jax.sources.detections import ClassNaming, detections_from
from remind_jax.sources.file_tree import read_of_frame
from remind_jax.sources.source import Content, Entry, Report


class ItemReader:
    """Items of an iterable.

    Each is one of
    - an image `[H, W, 3]` of bytes in RGB (also gray `[H, W]`, or with alpha);
    - the path of an image file;
    - a pair of such an image and its detections, in any form that `detections_from` takes;
    - a `Frame`, whose number, time and name are kept.

    An array `[T, H, W, 3]` is a sequence of images. An iterator can be read once only.
    """

    kind = "arrays"

    def __init__(
        self,
        items: Iterable[Any],
        name: str,
        fps: float | None,
        class_names: ClassNaming | None = None,
    ) -> None:
        self.name = name
        shown_fps = fps or UNTIMED_FPS
        self.fps: float | None = shown_fps
        self._interval_s = 1 / shown_fps
        self.num_entries: int | None = _length(items)
        self.entry_names: tuple[str, ...] | None = None
        self._items, self._class_names, self._is_timed = items, class_names, fps is not None
        self._is_used_up = False

    def entries(self, report: Report) -> Generator[Entry, None, None]:
        """Yields one entry per item."""
        del report
        iterator = iter(self._items)
        if iterator is self._items:
            if self._is_used_up:
                raise SourceError(
                    f"'{self.name}' is an iterator and was read already; give a list, or an "
                    "iterable that starts again"
                )
            self._is_used_up = True
        if not isinstance(self._items, Sequence | np.ndarray):
            # Frames are read ahead: one buffer that is filled anew would change those that wait.
            iterator = map(_copied, iterator)
        for index, item in enumerate(iterator):
            if isinstance(item, Frame):
                check_frame(item)
                read = functools.partial(Content, item.image, item.detections, item.features)
                yield Entry(item.source_index, item.time_s, item.name, read, item.is_timed)
                continue
            name = Path(item).name if isinstance(item, str | Path) else f"{index:06d}"
            read = functools.partial(_read_item, item, index, self._class_names)
            yield Entry(index, index * self._interval_s, name, read, self._is_timed)


class ArrayMasks:
    """Given masks by frame number."""

    def __init__(
        self,
        per_frame: Sequence[Any],
        convert: Callable[[Any, tuple[int, int]], Detections],
        num_frames: int | None,
    ) -> None:
        self.notes: list[str] = []
        if num_frames is not None and len(per_frame) > num_frames:
            self.notes.append(
                f"masks were given for {len(per_frame)} frames, of which there are {num_frames}"
            )
        self.frames = None
        self._per_frame, self._convert = per_frame, convert

    def detections_of(self, entry: Entry, frame_size: tuple[int, int]) -> Detections:
        """Detections of one frame.

        Raises:
          SourceError: If there are masks for fewer frames than there are frames.
        """
        if entry.source_index >= len(self._per_frame):
            raise SourceError(
                f"masks were given for {len(self._per_frame)} frames, but there is a frame "
                f"number {entry.source_index}; give one item per source frame (None for nothing)"
            )
        return self._convert(self._per_frame[entry.source_index], frame_size)


def _copied(item: Any) -> Any:
    """The same in arrays of its own."""
    if isinstance(item, np.ndarray):
        return item.copy()
    if isinstance(item, Frame):
        return dataclasses.replace(item, image=_copied(item.image))
    if isinstance(item, Mapping):
        return {key: _copied(value) for key, value in item.items()}
    return [*map(_copied, item)] if isinstance(item, tuple | list) else item


def _length(items: Iterable[Any]) -> int | None:
    shape = getattr(items, "shape", None)
    if shape == ():
        raise SourceError("an array of no dimensions is no source of frames; give [T, H, W, 3]")
    if shape is not None and len(shape) == 3 and shape[2] in (3, 4):
        raise SourceError(f"an array {[*shape]} is one picture; give [T, H, W, 3], or [picture]")
    return len(items) if isinstance(items, Sized) else None


def _read_item(item: Any, index: int, class_names: ClassNaming | None) -> Content:
    if isinstance(item, tuple | list) and len(item) == 2:
        image = _as_image(item[0], index)
        return Content(image, detections_from(item[1], image.shape[:2], class_names))
    return Content(_as_image(item, index))


def _as_image(item: Any, index: int) -> UInt8[np.ndarray, "H W 3"]:
    if isinstance(item, str | Path):
        return decode_image(read_of_frame(Path(item)))
    array = host_array(item, f"pixels of item {index}")
    if 0 in array.shape:
        raise SourceError(f"item {index} has shape {array.shape}: there are no pixels")
    if array.dtype == np.uint8 and array.ndim == 2:
        return np.repeat(array[:, :, None], 3, axis=2)
    if array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] in (1, 3, 4):
        channels = [0, 0, 0] if array.shape[2] == 1 else [0, 1, 2]
        return array if array.shape[2] == 3 else np.ascontiguousarray(array[:, :, channels])
    raise SourceError(
        f"item {index} is {type(item).__name__} of shape {array.shape} and type {array.dtype}; "
        "give images as uint8 RGB [H, W, 3], pairs (image, detections), or Frames"
    )
