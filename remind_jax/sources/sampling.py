"""Which frames of a source are processed: a range, a stride or a rate."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np

from remind_jax.errors import OptionError
from remind_jax.files.limits import MAX_FRAMES
from remind_jax.settings.ranges import check_option

MIN_RATE, MAX_RATE = 1e-6, 1e6  # frames per second
MAX_TIME_S = 1e10
RATE_SLACK = 1e-6  # frames; time stamps are rounded to the container's clock


TimedT = TypeVar("TimedT", bound=Any)  # has `source_index` and `time_s`, as `Entry`


@dataclasses.dataclass(frozen=True)
class Sampling:
    """Chooses frames by number first (`start`, `end`), then by `stride` or `fps`.

    Raises:
      OptionError: If a value is out of range, or both `fps` and `stride` are given.
    """

    fps: float | None = None  # at most so many frames per second of the source; never repeats one
    stride: int = 1  # every so many frames
    start: int = 0  # first source frame
    end: int | None = None  # source frame to stop before
    max_frames: int | None = None  # stop after so many chosen frames

    def __post_init__(self) -> None:
        if self.fps is not None:
            check_option("fps", self.fps, MIN_RATE, MAX_RATE, whole=False)
        for name, least in (("stride", 1), ("start", 0), ("end", 1), ("max_frames", 1)):
            if getattr(self, name) is not None or name in ("stride", "start"):
                check_option(name, getattr(self, name), least, MAX_FRAMES)
        if self.fps is not None and self.stride != 1:
            raise OptionError(
                f"both 'fps' ({self.fps:g}) and 'stride' ({self.stride}) are given; give one",
                "fps",
                "stride",
            )
        if self.end is not None and self.end <= self.start:
            raise OptionError(
                f"'end' is {self.end}; it is the frame to stop before and must lie after "
                f"'start', which is {self.start}",
                "start",
                "end",
            )

    def select(self, items: Iterable[TimedT]) -> Iterator[TimedT]:
        """Yields the chosen items, in order, and asks for none beyond the last of them."""
        chosen, last_tick, first_time_s = 0, -1, None
        for item in items:
            if self.end is not None and item.source_index >= self.end:
                return
            if item.source_index < self.start or (item.source_index - self.start) % self.stride:
                continue
            if self.fps is not None:
                first_time_s = item.time_s if first_time_s is None else first_time_s
                tick = math.floor((item.time_s - first_time_s) * self.fps + RATE_SLACK)
                if tick <= last_tick:
                    continue
                last_tick = tick
            yield item
            chosen += 1
            if chosen == self.max_frames or item.source_index + 1 == self.end:
                return

    def count(self, num_frames: int | None, source_fps: float | None) -> int | None:
        """How many of `num_frames` evenly timed frames are chosen; None if that is unknown."""
        ends = [n for n in (num_frames, self.end) if n is not None]
        if num_frames is None or (self.fps is not None and source_fps is None):
            return None
        count = -(-max(0, min(ends) - self.start) // self.stride)
        if self.fps is not None and source_fps is not None and self.fps < source_fps and count:
            count = math.floor((count - 1) / source_fps * self.fps + RATE_SLACK) + 1
        return count if self.max_frames is None else min(count, self.max_frames)

    def rate(self, source_fps: float | None) -> float | None:
        """Chosen frames per second of source time."""
        if source_fps is None:
            return self.fps
        return min(source_fps / self.stride, self.fps if self.fps is not None else math.inf)


def mean_rate(times_s: Sequence[float] | np.ndarray, otherwise: float) -> float:
    """Frames per second by the first and the last time."""
    if len(times_s) < 2 or times_s[-1] <= times_s[0]:
        return otherwise
    return float((len(times_s) - 1) / (times_s[-1] - times_s[0]))
