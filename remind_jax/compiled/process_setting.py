"""A setting of the whole process that is another one while programs are made."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

V = TypeVar("V")


class ProcessSetting(Generic[V]):
    """A setting that all threads share, changed as long as any of them needs that."""

    def __init__(self, read: Callable[[], V], write: Callable[[V], object], value: V) -> None:
        """Changes nothing yet.

        Args:
          read: Gives the setting as it is.
          write: Changes it.
          value: What it is to be for a while.
        """
        self._read, self._write, self._value = read, write, value
        self._lock = threading.Lock()
        self._before: list[V] = []  # what it was, for each thread within

    @contextlib.contextmanager
    def changed(self) -> Iterator[None]:
        """The setting has the value within; what it was comes back when the last thread leaves."""
        with self._lock:
            self._before.append(self._before[0] if self._before else self._read())
            self._write(self._value)
        try:
            yield
        finally:
            with self._lock:
                before = self._before.pop()
                if not self._before:
                    self._write(before)
