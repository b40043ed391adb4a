"""Cameras and streams: who takes frames slower than they come gets the newest, the rest is counted.

`Frame.time_s` is the time of arrival, from the first frame on.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import functools
import time
import weakref
from collections.abc import Callable, Generator, Iterator
from typing import Any

from remind_jax.errors import OptionError, SourceError
from remind_jax.frame import Frame, SkippedFrame
from remind_jax.settings.ranges import check_option
from remind_jax.sources.address import read_address
from remind_jax.sources.capture import Capture, open_capture
from remind_jax.sources.feed import Arrival, Feed, State
from remind_jax.sources.sampling import Sampling
from remind_jax.sources.source import Content, Entry, Report, SampledSource, UnreadableFrame

RECONNECT_S = 30.0
_MAX_SECONDS = 1e9
WAIT_S = 10.0  # that a connection or a picture may take
PASSED_OVER = "a newer one was there when the tracker was ready"


@dataclasses.dataclass(frozen=True)
class LiveOptions:
    """How a live source is read. Raises OptionError if a value is out of range."""

    duration: float | None = None  # end after so many seconds
    reconnect: float = RECONNECT_S  # seconds that a lost source is waited for

    def __post_init__(self) -> None:
        if self.duration is not None:
            check_option("duration", self.duration, 1e-3, _MAX_SECONDS, whole=False)
        check_option("reconnect", self.reconnect, 0, _MAX_SECONDS, whole=False)

    def refuse_for_recordings(self, shown: str) -> None:
        """Raises OptionError if one is given for a source that does not go on by itself."""
        for field in dataclasses.fields(self):
            if getattr(self, field.name) != field.default:
                raise OptionError(
                    f"'{field.name}' is for a camera or a stream, and '{shown}' is none; leave it "
                    "out",
                    field.name,
                )


@dataclasses.dataclass(frozen=True)
class SourceStatus:
    """How a live source does now."""

    state: State
    shown: str  # what it is called
    silent_s: float  # seconds since the last picture, or since all that come are left out
    num_arrived: int
    num_missed: int  # passed over for newer ones


class LiveReader:
    """Pictures of a live source, as a `Reader`. Raises SourceError if it cannot be opened."""

    entry_names: tuple[str, ...] | None = None
    num_entries: int | None = None
    fps: float | None = None

    def __init__(
        self,
        kind: str,
        name: str,
        shown: str,
        open_capture: Callable[[float], Capture],
        options: LiveOptions,
    ) -> None:
        self.kind, self.name, self.shown = kind, name, shown
        self._open_capture, self._options = open_capture, options
        self.num_missed = 0
        self.origin: float | None = None
        self.before_first: Callable[[Content], None] | None = None
        self.feed = self._start()
        self._is_fresh = True

    def _start(self) -> Feed:
        reconnect_s = self._options.reconnect
        wait_s = max(1.0, min(WAIT_S, reconnect_s / 2 if reconnect_s else WAIT_S))
        feed = Feed(self._open_capture, self.shown, reconnect_s=reconnect_s, wait_s=wait_s)
        weakref.finalize(self, feed.stop)  # at the end of the process while modules are still whole
        return feed

    def entries(self, report: Report) -> Generator[Entry, None, None]:
        """Yields what arrives, the newest first; at the end the count of those passed over."""
        if not self._is_fresh:
            self.feed = self._start()
        feed, self._is_fresh = self.feed, False
        self.num_missed, self.origin = 0, None
        first = last = -1
        try:
            self._get_ready(feed)
            while (arrival := self._take(feed)) is not None:
                if self.origin is None:
                    self.origin = arrival.arrived
                    first, last = arrival.number, arrival.number - 1
                self.num_missed += arrival.number - last - 1
                last = arrival.number
                number, time_s = last - first, arrival.arrived - self.origin
                yield Entry(number, time_s, f"{number:06d}", arrival.read, is_timed=True)
        finally:
            feed.stop()
            if self.num_missed:
                report(SkippedFrame("frames that arrived", PASSED_OVER, self.num_missed))

    def _get_ready(self, feed: Feed) -> None:
        """Shows the first picture to `before_first`, before any counts; a newer one may follow."""
        if self.before_first is None or (arrival := feed.take()) is None:
            return
        with contextlib.suppress(UnreadableFrame):
            self.before_first(arrival.read())
        feed.put_back(arrival)

    def _take(self, feed: Feed) -> Arrival | None:
        duration = self._options.duration
        if duration is None or self.origin is None:
            return feed.take()
        until = self.origin + duration
        arrival = feed.take(until) if time.monotonic() < until else None
        return arrival if arrival is not None and arrival.arrived <= until else None


class LiveSource(SampledSource):
    """A source that goes on by itself, until it ends, `stop` is called or its time is over.

    The size of its frames may change.

    Attributes:
      opened_at: Nearly the moment of its time 0.
    """

    def __init__(self, reader: LiveReader, sampling: Sampling) -> None:
        super().__init__(reader, None, sampling, allow_size_change=True)
        self._live = reader
        self._news: list[str] = []
        self._left_out_since: float | None = None  # None if the last picture was used
        self._is_used = True
        self.opened_at = datetime.datetime.now(datetime.UTC)

    def __iter__(self) -> Iterator[Frame]:
        """As of every source; a frame that nobody leaves out (`leave_out`) is used."""
        for frame in super().__iter__():
            self._is_used = True
            yield frame
            if self._is_used:
                self._left_out_since = None

    def get_ready_by(self, before_first: Callable[[Content], None]) -> None:
        """Sets what is shown a picture before the first one counts, as to compile for its size."""
        self._live.before_first = before_first

    def stop(self) -> None:
        """Ends the iteration after the frame in work; may be called by another thread."""
        self._live.feed.stop()

    def take_news(self) -> list[str]:
        """What happened since the last call, as a connection lost and found again."""
        news, self._news = self._news, []
        return [*self._live.feed.take_news(), *news]

    def leave_out(self, frame: SkippedFrame) -> None:
        """Counts pictures by reason, since there is no end of them; the first is news."""
        self._is_used, now = False, time.monotonic()
        self._left_out_since = now if self._left_out_since is None else self._left_out_since
        for place, other in enumerate(self.skipped):
            if other.reason == frame.reason:
                self.skipped[place] = dataclasses.replace(other, count=other.count + 1)
                return
        self.skipped.append(frame)
        self._news.append(f"a picture of '{self._live.shown}' is left out: {frame.reason}")

    def status(self) -> SourceStatus:
        """How it does now."""
        reader, feed, since = self._live, self._live.feed, self._left_out_since
        silent_s = feed.silent_s if since is None else time.monotonic() - since
        return SourceStatus(feed.state, reader.shown, silent_s, feed.num_arrived, reader.num_missed)

    def age_s(self, frame: Frame) -> float:
        """Seconds since a frame of this iteration arrived."""
        origin = self._live.origin
        return 0.0 if origin is None else time.monotonic() - origin - frame.time_s

    def describe(self) -> dict[str, Any]:
        """What it is, as JSON; it cannot be opened again."""
        opened_at = self.opened_at.isoformat(timespec="milliseconds")
        return {**super().describe(), "address": self._live.shown, "opened_at": opened_at}


def open_live(
    spec: Any, masks: Any, name: str | None, sampling: Sampling, options: LiveOptions
) -> LiveSource | None:
    """Opens a camera or a stream; None if it is another source. Arguments as in `open_source`.

    Raises:
      SourceError: If it cannot be opened, or masks are given.
    """
    address = read_address(spec)
    if address is None:
        return None
    if masks is not None and not (isinstance(masks, str) and masks == "none"):
        raise SourceError(
            f"'{address.shown}' is live, so that no masks can belong to its frames; give a detector"
        )
    open_it = functools.partial(open_capture, address)
    reader = LiveReader(address.kind, name or address.name, address.shown, open_it, options)
    return LiveSource(reader, sampling)
