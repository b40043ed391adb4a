"""A live source read in a thread of its own; times are seconds of `time.monotonic`."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import threading
import time
from collections.abc import Callable
from typing import Literal

from remind_jax.errors import SourceError
from remind_jax.sources.capture import Capture, Lost, Picture, Unreachable

State = Literal["connected", "lost", "ended"]
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.25, 5.0  # between two attempts to reconnect
_SHORTEST_WAIT_S = 0.5  # that opening may take
_WAKE_S = 0.5  # so often a waiting reader lets signals through
_LEAVE_S = 1.0  # waited for the thread; what hangs in a driver is left behind


@dataclasses.dataclass(frozen=True)
class Arrival:
    """A picture, and when it came."""

    read: Picture
    number: int  # in the source; counts those passed over as well
    arrived: float


class Feed:
    """Reads a source until it is stopped, keeps its newest picture, opens it again if it is lost.

    Attributes:
      num_arrived: Pictures so far.
      state: Whether it gives pictures now.
    """

    def __init__(
        self,
        open_source: Callable[[float], Capture],
        shown: str,
        *,
        reconnect_s: float,
        wait_s: float,
    ) -> None:
        """Opens the source and starts to read it.

        Args:
          reconnect_s: For so long it may be lost; with 0, that is its end and no error.
          wait_s: For so long it may be silent, and opening may take.

        Raises:
          SourceError: If it cannot be opened.
        """
        self._open, self._shown = open_source, shown
        self._reconnect_s, self._wait_s = reconnect_s, wait_s
        self.num_arrived = 0
        self._waiting = collections.deque[Arrival](maxlen=1)
        self._news: list[str] = []
        self.state: State = "connected"
        self._error: SourceError | None = None
        self._changed, self._stopping = threading.Condition(), threading.Event()
        self._capture = open_source(wait_s)
        self._last = time.monotonic()  # when something came
        # Stopped in any case when the process ends.
        self._thread = threading.Thread(target=self._watch, name="live source", daemon=True)
        self._thread.start()

    @property
    def silent_s(self) -> float:
        """Seconds since the last picture."""
        return time.monotonic() - self._last

    def take(self, until: float | None = None) -> Arrival | None:
        """Waits for a picture that was not taken yet; None at the end of the source.

        Raises:
          SourceError: If the source is lost for too long.
        """
        with self._changed:
            while not self._waiting:
                left_s = _WAKE_S if until is None else min(_WAKE_S, until - time.monotonic())
                if left_s <= 0 or self._stopping.is_set():
                    return None
                if self.state == "ended":
                    if self._error is not None:
                        raise self._error
                    return None
                self._changed.wait(left_s)
            return None if self._stopping.is_set() else self._waiting.popleft()

    def put_back(self, arrival: Arrival) -> None:
        """Gives back a picture that was only looked at; one that is newer takes its place."""
        with self._changed:
            if not self._waiting:
                self._waiting.append(arrival)

    def take_news(self) -> list[str]:
        """What happened since the last call, in sentences."""
        with self._changed:
            news, self._news = self._news, []
        return news

    def stop(self) -> None:
        """Ends the reading; whoever waits in `take` gets None."""
        self._stopping.set()
        with self._changed:
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(_LEAVE_S)

    def _watch(self) -> None:
        """The thread: reads until the end."""
        error: SourceError | None = None
        try:
            why: str | None = ""
            while why is not None and not self._stopping.is_set():
                why = self._read_on()
                if why is not None:
                    why = self._reconnect(why)
        except SourceError as caught:
            error = caught
        except Exception as caught:  # told where the pictures are waited for
            error = SourceError(f"'{self._shown}' cannot be read: {type(caught).__name__}")
            error.__cause__ = caught
        finally:
            with contextlib.suppress(Exception):
                self._capture.close()
            with self._changed:
                self.state, self._error = "ended", error
                self._changed.notify_all()

    def _read_on(self) -> str | None:
        """Reads until the source is lost, and says why; None if it has ended."""
        while not self._stopping.is_set():
            try:
                picture = self._capture.read()
            except Lost as lost:
                why = str(lost)
            else:
                if picture is not None:
                    self._add(picture)
                    continue
                why = "ended"
            if self._reconnect_s == 0 and self.num_arrived:
                with self._changed:
                    self._news.append(f"'{self._shown}' {why}, and the run with it")
                return None
            return why
        return None

    def _add(self, picture: Picture) -> None:
        with self._changed:
            now = time.monotonic()
            if self.state == "lost":
                gone_s = now - self._last
                self._news.append(f"'{self._shown}' was lost for {gone_s:.1f} s and came back")
            self._waiting.append(Arrival(picture, self.num_arrived, now))
            self.num_arrived += 1
            self.state, self._last = "connected", now
            self._changed.notify_all()

    def _reconnect(self, why: str) -> str | None:
        """Opens the source again, as soon as it can be; None if it is to be stopped.

        Raises:
          SourceError: If that takes too long.
        """
        if self.num_arrived == 0:
            raise SourceError(f"'{self._shown}' {why} before its first picture; is it on?")
        self._capture.close()
        with self._changed:
            self.state = "lost"
        pause_s, reason = _FIRST_PAUSE_S, f"it {why}"
        while (left_s := self._reconnect_s - self.silent_s) > 0:
            if self._stopping.wait(min(pause_s, left_s)):
                return None
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
            try:
                self._capture = self._open(max(_SHORTEST_WAIT_S, min(self._wait_s, left_s)))
                return why
            except Unreachable as error:
                reason = str(error).partition(";")[0]
        raise SourceError(
            f"'{self._shown}' was lost ({reason}) and did not come back within "
            f"{self._reconnect_s:g} s; everything until then is kept, give more seconds to wait "
            "for it ('reconnect')"
        )
