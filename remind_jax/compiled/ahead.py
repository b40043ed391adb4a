"""Larger capacities, compiled in the background before they are needed, so that no frame waits."""

from __future__ import annotations

import collections
import dataclasses
import logging
import sys
import threading
from collections.abc import Callable, Mapping, Sequence

from remind_jax.compiled.process_setting import ProcessSetting
from remind_jax.static import GROWTH_STEP, Static

PRESSED = 3 / 4  # share of a capacity from which on the next one is prepared
HORIZON_S = 40.0  # how far ahead growth is foreseen; a compilation takes less
WINDOW_S = 30.0  # over which the pace of growth is measured
SHORTEST_S = 5.0  # what was met in less says nothing about a pace
SETTLED_S = 20.0  # after which a stream is taken for one that goes on,
SETTLED_FRAMES = 200  # or after so many frames
PREPARING = "remind-jax prepares capacities"  # name of the thread
_SAMPLE_S = 0.25  # samples that are kept lie so far apart
# Python lets another thread run after so long; at its usual 5 ms, a frame that gives way a hundred
# times while a program is traced takes most of a second.
_TURN_S = 0.0005
_short_turns = ProcessSetting(sys.getswitchinterval, sys.setswitchinterval, _TURN_S)

Occupied = Mapping[str, int]  # slots in use by the name of their capacity in `Static`

_log = logging.getLogger(__name__)


class Forecast:
    """Tells which capacities will be too small soon, from how fast they have filled up."""

    def __init__(self) -> None:
        self._past: collections.deque[tuple[float, Occupied]] = collections.deque()
        self._begun_s: float | None = None
        self._num_frames = 0

    def add(self, time_s: float, occupied: Occupied) -> None:
        """Takes note of the slots that were in use at a time, in seconds of any clock."""
        if self._begun_s is None:
            self._begun_s = time_s
        self._num_frames += 1
        while len(self._past) > 1 and self._past[1][0] <= time_s - WINDOW_S:
            self._past.popleft()
        if len(self._past) > 1 and time_s - self._past[-2][0] < _SAMPLE_S:
            self._past.pop()
        self._past.append((time_s, occupied))

    @property
    def is_settled(self) -> bool:
        """Whether the stream has gone on for a while."""
        if self._begun_s is None:
            return False
        lasted_s = self._past[-1][0] - self._begun_s
        return lasted_s >= SETTLED_S or self._num_frames >= SETTLED_FRAMES

    def is_sure(self, static: Static) -> bool:
        """Whether what stays, objects and undecided tracks, fills the present capacities nearly."""
        if not self._past:
            return False
        _, occupied = self._past[-1]
        lasting = ("num_objects", "num_pending")
        return any(occupied[name] >= PRESSED * getattr(static, name) for name in lasting)

    def needed(self, static: Static) -> Static:
        """`static` with the next capacity wherever the present one will not last."""
        if not self._past:
            return static
        (start, before), (now, occupied) = self._past[0], self._past[-1]
        grown = {}
        for name, count in occupied.items():
            capacity = getattr(static, name)
            pace = 0.0
            if name == "num_objects" and now - start >= SHORTEST_S:  # the rest comes and goes
                pace = (count - before[name]) / (now - start)
            if count >= PRESSED * capacity or count + pace * HORIZON_S > capacity:
                grown[name] = capacity + 1
        return static.grow(**grown) if grown else static


class Preparation:
    """One background thread at a time that prepares capacities; they wait until they are needed."""

    def __init__(self) -> None:
        self._ready: list[Static] = []
        self._planned: Static | None = None
        self._failed: set[Static] = set()
        self._wanted: Static | None = None  # what the thread prepares
        self._thread: threading.Thread | None = None

    def plan(self, ready: Sequence[Static], covered: Static | None = None) -> None:
        """Takes capacities that were prepared on purpose, for what somebody knows will come.

        Args:
          ready: Capacities at hand, the largest last.
          covered: What they are meant to suffice for, the largest if left out: nothing that this
            holds is begun before it is sure to be needed.
        """
        self._ready += [static for static in ready if static not in self._ready]
        self._planned = ready[-1] if covered is None else covered

    def start(
        self, static: Static, prepare: Callable[[Static], None], *, is_sure: bool = False
    ) -> None:
        """Prepares these capacities, unless others are in preparation, or these need not be.

        Args:
          static: Capacities.
          prepare: Prepares them.
          is_sure: What fills the present ones up is there already, and stays, so that these are
            worth while whatever is planned, unless something at most twice as large is at hand:
            with something larger, every step takes longer.
        """
        if self._is_busy() or static in self._failed or static in self._ready:
            return
        is_planned = self._planned is not None and holds(self._planned, static)
        if is_planned and not (is_sure and not self._is_nearly_at_hand(static)):
            return

        def run() -> None:
            try:
                with _short_turns.changed():
                    prepare(static)
            except Exception:  # the frame that needs these capacities will tell
                self._failed.add(static)
                _log.debug("could not prepare %s", static, exc_info=True)
            else:
                self._ready.append(static)

        self._wanted = static
        # No daemon: the compiler must not be at work while the process is taken down.
        self._thread = threading.Thread(target=run, name=PREPARING)
        self._thread.start()

    def room_for(self, needed: Static) -> Static:
        """The least capacities at hand that hold these, else just these.

        Waits for what is in preparation if that holds them.
        """
        if self._wanted is not None and holds(self._wanted, needed):
            self.finish()
        at_hand = [static for static in self._ready if holds(static, needed)]
        return min(at_hand, key=_capacities, default=needed)

    def following(self, present: Static) -> Static | None:
        """The least capacities at hand that hold more than these."""
        larger = [one for one in self._ready if one != present and holds(one, present)]
        return min(larger, key=_capacities, default=None)

    def finish(self) -> None:
        """Waits for what is in preparation."""
        if self._thread is not None:
            self._thread.join()

    def _is_nearly_at_hand(self, static: Static) -> bool:
        """Whether capacities are at hand that hold these, and of none more than twice."""
        return any(
            holds(one, static)
            and all(
                most <= GROWTH_STEP * least
                for most, least in zip(_capacities(one), _capacities(static), strict=True)
            )
            for one in self._ready
        )

    def _is_busy(self) -> bool:
        return self._thread is not None and self._thread.is_alive()


def holds(large: Static, small: Static) -> bool:
    """Whether capacities hold at least others, and are the same in all else."""
    pairs = zip(_capacities(large), _capacities(small), strict=True)
    return _without_capacities(large) == _without_capacities(small) and all(
        most >= least for most, least in pairs
    )


def _capacities(static: Static) -> tuple[int, ...]:
    return static.num_objects, static.num_detections, static.num_pending


def _without_capacities(static: Static) -> Static:
    return dataclasses.replace(static, num_objects=1, num_detections=1, num_pending=1)
