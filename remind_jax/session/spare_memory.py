"""The empty memory that a growth will move into, made before it is needed."""

from __future__ import annotations

import logging
import threading
from typing import Any

from remind_jax.method import Method
from remind_jax.static import Static

MOST_IDLE_BYTES = 1 << 28  # of memory and step, that may lie ready for a growth nobody foresees

_log = logging.getLogger(__name__)


class SpareMemory:
    """One empty memory on the host, of capacities whose programs are at hand.

    To get so much memory of the system takes several times as long as to write into it what is
    remembered; the frame that grows would wait for that.
    """

    def __init__(self, method: Method) -> None:
        """Makes nothing yet."""
        self._method = method
        self._made: tuple[Static, Any] | None = None
        self._asked: Static | None = None
        self._thread: threading.Thread | None = None

    def ask_for(self, static: Static, *, is_foreseen: bool, waits: bool = False) -> None:
        """Has that of these capacities made, in place of the one at hand.

        Args:
          static: Capacities.
          is_foreseen: Whether they will be needed soon; if not, only a small one is made.
          waits: Return when it is there; otherwise a thread of its own makes it.
        """
        if static == self._asked or not (is_foreseen or self._is_small(static)):
            return
        if self._thread is not None and self._thread.is_alive():
            return
        self._asked, self._made = static, None
        self._thread = threading.Thread(target=self._make, args=(static,), name="remind-jax room")
        self._thread.start()
        if waits:
            self._thread.join()

    def take(self, static: Static) -> Any:
        """That of these capacities, which is used up; None if it is not at hand."""
        made, self._made, self._asked = self._made, None, None
        return None if made is None or made[0] != static else made[1]

    def _make(self, static: Static) -> None:
        try:
            self._made = static, self._method.make_empty(static)
        except Exception:  # the frame that needs it will tell
            _log.debug("could not make room for %s", static, exc_info=True)

    def _is_small(self, static: Static) -> bool:
        count = self._method.host.count_bytes
        return count is None or count(static) <= MOST_IDLE_BYTES
