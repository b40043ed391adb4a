"""Larger capacities, prepared by a thread of their own before a frame needs them."""

from __future__ import annotations

import dataclasses
import logging
import threading
from collections.abc import Callable
from typing import Any

from remind_jax.method import Method
from remind_jax.static import GROWTH_STEP, Static

# Share of a capacity from which on twice of it is prepared: objects stay, the rest comes and goes.
PRESSED = {"num_detections": 3 / 4, "num_objects": 1 / 2, "num_pending": 3 / 4}

_log = logging.getLogger("remind_jax")


class Ahead:
    """Larger capacities at hand, and a thread that makes one thing at a time.

    Attributes:
      at_hand: Capacities whose programs are there.
    """

    def __init__(self, method: Method) -> None:
        """Prepares nothing yet."""
        self.at_hand: list[Static] = []
        self._method = method
        self._spare: tuple[Static, Any] | None = None  # an empty memory on the host
        self._failed: set[Static] = set()
        self._wanted: Static | None = None  # what the thread prepares
        self._thread: threading.Thread | None = None

    def start(
        self, static: Static, compile_them: Callable[[], None] | None, with_spare: bool
    ) -> None:
        """Prepares capacities, unless the thread is at work, they are there, or they failed.

        Args:
          static: Capacities.
          compile_them: Compiles their program; None if that is at hand.
          with_spare: Make the memory as well: to get so much of the system takes several times as
            long as to write into it what is remembered.
        """
        is_there = self._spare is not None and self._spare[0] == static
        is_busy = self._thread is not None and self._thread.is_alive()
        if is_busy or static in self._failed or (compile_them is None and is_there):
            return

        def run() -> None:
            try:
                if compile_them is not None:
                    compile_them()
                    self.at_hand.append(static)
                if with_spare:
                    self._spare = static, self._method.make_empty(static)
            except Exception:  # the frame that needs these capacities will tell
                self._failed.add(static)
                _log.debug("could not prepare %s", static, exc_info=True)

        self._wanted = static
        # No daemon: the compiler must not be at work while the process is taken down.
        self._thread = threading.Thread(target=run, name="remind-jax prepares capacities")
        self._thread.start()

    def is_near(self, static: Static) -> bool:
        """Whether capacities are at hand that hold these, and of none more than twice."""
        return any(
            holds(one, static)
            and all(
                most <= GROWTH_STEP * least
                for most, least in zip(_capacities(one), _capacities(static), strict=True)
            )
            for one in self.at_hand
        )

    def room_for(self, needed: Static) -> Static:
        """The least capacities at hand that hold these, else just these.

        Waits for what is in preparation if that holds them.
        """
        if self._wanted is not None and holds(self._wanted, needed):
            self.finish()
        fitting = [static for static in self.at_hand if holds(static, needed)]
        return min(fitting, key=_capacities, default=needed)

    def following(self, present: Static) -> Static | None:
        """The least capacities at hand that hold more than these."""
        larger = [one for one in self.at_hand if one != present and holds(one, present)]
        return min(larger, key=_capacities, default=None)

    def take_spare(self, static: Static) -> Any:
        """The empty memory of these capacities, which is used up; None if it is not at hand."""
        spare, self._spare = self._spare, None
        return None if spare is None or spare[0] != static else spare[1]

    def finish(self) -> None:
        """Waits for what is in preparation."""
        if self._thread is not None:
            self._thread.join()


def holds(large: Static, small: Static) -> bool:
    """Whether capacities hold at least others, and are the same in all else."""
    pairs = zip(_capacities(large), _capacities(small), strict=True)
    names = dict.fromkeys(PRESSED, 1)
    same = dataclasses.replace(large, **names) == dataclasses.replace(small, **names)
    return same and all(most >= least for most, least in pairs)


def _capacities(static: Static) -> tuple[int, ...]:
    return static.num_objects, static.num_detections, static.num_pending
