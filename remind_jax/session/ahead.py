"""The program of larger capacities, compiled by a thread of its own before a frame needs it."""

from __future__ import annotations

import dataclasses
import logging
import threading
from collections.abc import Callable

from remind_jax.compiled.programs import waiting
from remind_jax.static import Static

_log = logging.getLogger("remind_jax")
_CAPACITIES = ("num_objects", "num_detections", "num_pending")


class Ahead:
    """Capacities whose program is at hand, and a thread that makes one at a time."""

    def __init__(self) -> None:
        """Prepares nothing yet."""
        self._at_hand: list[Static] = []
        self._tried: set[Static] = set()
        self._thread: threading.Thread | None = None

    def start(self, static: Static, compile_them: Callable[[], None]) -> None:
        """Prepares capacities, unless the thread is at work or has tried them."""
        is_busy = self._thread is not None and self._thread.is_alive()
        if is_busy or static in self._tried:
            return

        def run() -> None:
            try:
                compile_them()
                self._at_hand.append(static)
            except Exception:  # the frame that needs these capacities will tell
                _log.debug("could not prepare %s", static, exc_info=True)

        self._tried.add(static)
        # No daemon: the compiler must not be at work while the process is taken down.
        self._thread = threading.Thread(target=run, name="remind-jax prepares capacities")
        self._thread.start()

    def room_for(self, needed: Static) -> Static:
        """The least capacities at hand that hold these, else just these.

        Waits for what is in preparation.
        """
        self.finish()
        fitting = [static for static in self._at_hand if holds(static, needed)]
        return min(fitting, key=_capacities, default=needed)

    def finish(self) -> None:
        """Waits for what is in preparation."""
        if self._thread is not None:
            with waiting():
                self._thread.join()


def holds(large: Static, small: Static) -> bool:
    """Whether capacities hold at least others, and are the same in all else."""
    pairs = zip(_capacities(large), _capacities(small), strict=True)
    names = dict.fromkeys(_CAPACITIES, 1)
    same = dataclasses.replace(large, **names) == dataclasses.replace(small, **names)
    return same and all(most >= least for most, least in pairs)


def _capacities(static: Static) -> tuple[int, ...]:
    return tuple(getattr(static, name) for name in _CAPACITIES)
