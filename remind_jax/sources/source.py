"""The one shape of input: an iterable of frames that says what it could not read.

A *reader* hands out entries, still undecoded; a *mask provider* knows the detections of each.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Collection, Generator, Iterator
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.crops import require_room
from remind_jax.errors import SourceError, UnreadableFrame, as_text
from remind_jax.frame import Detections, Frame, SkippedFrame
from remind_jax.sources.sampling import Sampling
from remind_jax.static import MOST_DETECTIONS


@runtime_checkable
class Source(Protocol):
    """Frames in temporal order; iterating again starts again where the storage allows it."""

    name: str
    num_frames: int | None  # after sampling; None if unknown, an estimate for some videos
    fps: float | None  # frames per second after sampling
    skipped: list[SkippedFrame]  # of the latest iteration, so far
    notes: list[str]  # sentences worth showing to the user once

    def __iter__(self) -> Iterator[Frame]: ...

    def describe(self) -> dict[str, Any]:
        """What it is, as JSON; `reopen` holds the arguments of `open_source`, or None."""
        ...


@dataclasses.dataclass(frozen=True)
class Content:
    """What one entry holds once it is decoded."""

    image: UInt8[np.ndarray, "H W 3"] | None = None  # RGB
    detections: Detections | None = None
    features: Float[np.ndarray, "Hp Wp D"] | None = None


@dataclasses.dataclass(frozen=True)
class Entry:
    """One frame of a storage, not yet decoded: skipping it costs nothing."""

    source_index: int
    time_s: float
    name: str
    read: Callable[[], Content]  # raises UnreadableFrame
    is_timed: bool = False  # as of `Frame`

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", as_text(self.name))


Report = Callable[[SkippedFrame], None]


class Reader(Protocol):
    """One kind of storage."""

    kind: str  # "video", "images", ...
    name: str
    fps: float | None
    num_entries: int | None
    entry_names: tuple[str, ...] | None  # where they are known beforehand

    def entries(self, report: Report) -> Generator[Entry, None, None]:
        """Yields entries in order; what cannot even be listed goes to `report`."""
        ...


class MaskProvider(Protocol):
    """Detections kept apart from the images."""

    notes: list[str]

    @property
    def frames(self) -> Collection[int] | None:
        """Frames of the source that have any; None if that is not known."""
        ...

    def detections_of(self, entry: Entry, frame_size: tuple[int, int]) -> Detections:
        """Detections of one frame in its own pixels.

        Raises:
          UnreadableFrame: If the masks of this frame are damaged.
          SourceError: If the masks cannot be meant for these frames.
        """
        ...


class SampledSource:
    """A reader seen through a sampling, with masks where there are any.

    Attributes:
      most_detections: A frame with more is skipped.
    """

    def __init__(
        self,
        reader: Reader,
        masks: MaskProvider | None = None,
        sampling: Sampling | None = None,
        *,
        allow_size_change: bool = False,
        reopen: dict[str, Any] | None = None,
    ) -> None:
        sampling = sampling or Sampling()
        self.name = reader.name
        self.num_frames = sampling.count(reader.num_entries, reader.fps)
        self.fps = sampling.rate(reader.fps)
        self.skipped: list[SkippedFrame] = []
        self.most_detections = MOST_DETECTIONS
        self.notes = masks.notes if masks is not None else []  # masks go on to add to them
        self._reader, self._masks, self._sampling = reader, masks, sampling
        self._allow_size_change = allow_size_change
        self._reopen = reopen
        if self.num_frames == 0:
            raise SourceError(self._say_empty())

    def __iter__(self) -> Iterator[Frame]:
        """Yields the readable frames; the others go to `skipped`.

        Raises:
          SourceError: If not one frame can be read, or masks do not belong to these frames.
        """
        self.skipped.clear()
        index, first_size, chosen = 0, None, set[int]()
        with contextlib.closing(self._reader.entries(self.skipped.append)) as entries:
            for entry in self._sampling.select(entries):
                chosen.add(entry.source_index)
                try:
                    frame = self._read(entry, index, first_size)
                except UnreadableFrame as error:
                    self.leave_out(SkippedFrame(entry.name, str(error)))
                    continue
                if first_size is None and frame.image is not None:
                    first_size = frame.size
                index += 1
                yield frame
        if index == 0:
            raise SourceError(self._say_empty())
        if self._masks is not None:
            self.notes = [*self._masks.notes, *self._say_unused(chosen)]

    def describe(self) -> dict[str, Any]:
        """What it is, as JSON; `reopen` holds the arguments of `open_source`, or None."""
        return {
            "kind": self._reader.kind,
            "name": self.name,
            "num_frames": self.num_frames,
            "fps": self.fps,
            "reopen": self._reopen,
        }

    def leave_out(self, frame: SkippedFrame) -> None:
        """Notes that a frame is skipped."""
        self.skipped.append(frame)

    def _read(self, entry: Entry, index: int, first_size: tuple[int, int] | None) -> Frame:
        content = entry.read()
        frame = Frame(
            index,
            entry.source_index,
            entry.time_s,
            entry.name,
            content.image,
            content.detections,
            content.features,
            entry.is_timed,
        )
        is_same_size = content.image is None or first_size in (None, frame.size)
        if not is_same_size and not self._allow_size_change:
            raise UnreadableFrame(
                f"its size is {say_size(frame.size)}, but the sequence is "
                f"{say_size(first_size)} (width x height)"
            )
        if self._masks is not None:
            if content.image is None and content.detections is None:
                raise SourceError(f"'{self.name}' has no images that the masks could belong to")
            detections = self._masks.detections_of(entry, frame.size)
            frame = dataclasses.replace(frame, detections=detections)
        if frame.detections is not None:
            require_room(len(frame.detections), frame.size, "it", self.most_detections)
        return frame

    def _say_unused(self, chosen: set[int]) -> list[str]:
        """What shows that detections are numbered otherwise than the frames that were chosen."""
        given = set(self._masks.frames or ()) if self._masks is not None else set()
        unused, lacking = given - chosen, chosen - given
        if not unused or (not lacking and self._sampling != Sampling()):
            return []
        return [
            f"detections of {len(unused)} of {len(given)} frames belong to no frame that was "
            f"processed, and {len(lacking)} of {len(chosen)} processed frames have none: see that "
            f"they are numbered as the frames of '{self.name}', before any stride or rate"
        ]

    def _say_empty(self) -> str:
        if self.skipped:
            first = self.skipped[0]
            num = sum(skipped.count for skipped in self.skipped)
            return (
                f"none of the {num} frames of '{self.name}' could be read; "
                f"the first was '{first.name}': {first.reason}"
            )
        if self._reader.num_entries:
            return (
                f"'{self.name}' has {self._reader.num_entries} frames, numbered from 0; the first "
                f"one asked for is number {self._sampling.start}; lower the start"
            )
        if self._sampling.start:
            return f"'{self.name}' has no frame from number {self._sampling.start} on"
        return f"'{self.name}' has no frames"


def say_size(size: tuple[int, int] | None) -> str:
    """`(height, width)` as people write it: width x height."""
    return "of unknown size" if size is None else f"{size[1]}x{size[0]}"
