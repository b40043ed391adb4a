"""Messages of several topics that belong to one image."""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from typing import Any

from remind_jax.errors import SourceError
from remind_jax.settings.ranges import check_option

# A message older than another of its topic by this starts a new time; what comes out of order, as
# from a detector that answers several images at once, is nearer.
_RESTART_NS = 1_000_000_000
MOST_WAITING = 60  # messages of a topic that are kept while others are missing
_MAX_SLOP_S = 60.0


def slop_in_ns(slop_s: float) -> int:
    """By how much stamps of one image may differ, in nanoseconds.

    Raises:
      OptionError: If it is no time.
    """
    check_option("slop_s", slop_s, 0, _MAX_SLOP_S, whole=False)
    return round(1e9 * slop_s)


class Pairing:
    """Collects messages by stamp until those of one image are complete.

    Detections bear the stamp of their image, as a rule exactly. What is not newer than the last
    complete set is let go, and so is the oldest message of a topic that has too many. Where time
    starts again, as in a bag that is played in a loop, so does the pairing.
    """

    def __init__(self, topics: Sequence[str], slop_ns: int, most: int = MOST_WAITING) -> None:
        """Waits for one message of each topic.

        Args:
          topics: The first one is that of the image.
          slop_ns: By how much stamps of one image may differ, in nanoseconds.
          most: Messages of a topic that are kept while others are missing.
        """
        self._slop_ns, self._most = slop_ns, most
        self._waiting: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in topics}
        self._done_ns = dict.fromkeys(topics, -1)  # stamps of the last complete set
        self._newest_ns = dict(self._done_ns)
        self.is_full = False  # whether the last message made an older one of its topic go

    def add(self, topic: str, stamp_ns: int, message: Any) -> list[dict[str, Any]]:
        """Takes a message; gives the sets, by topic, that it completes, oldest first.

        Raises:
          SourceError: If nobody set its stamp.
        """
        if stamp_ns <= 0:
            raise SourceError(
                f"a message of '{topic}' has the stamp {stamp_ns} ns; messages of one image are "
                "found by stamps above 0, so have its sender set 'header.stamp'"
            )
        if stamp_ns < self._newest_ns[topic] - _RESTART_NS:
            self._waiting = {name: [] for name in self._waiting}
            self._done_ns = dict.fromkeys(self._waiting, -1)
            self._newest_ns = dict(self._done_ns)
        self._newest_ns[topic] = max(self._newest_ns[topic], stamp_ns)
        waiting = self._waiting[topic]
        if stamp_ns <= self._done_ns[topic]:
            return []
        bisect.insort(waiting, (stamp_ns, message), key=lambda one: one[0])
        self.is_full = len(waiting) > self._most
        del waiting[: -self._most]
        image_topic, *others = self._waiting
        complete = []
        for stamp, image in list(self._waiting[image_topic]):
            found = {name: self._nearest(name, stamp) for name in others}
            if any(one is None for one in found.values()):
                continue
            times = {image_topic: stamp, **{name: one[0] for name, one in found.items() if one}}
            complete.append({image_topic: image, **{n: one[1] for n, one in found.items() if one}})
            self._done_ns = times
            for name, time in times.items():
                self._waiting[name] = [one for one in self._waiting[name] if one[0] > time]
        return complete

    def _nearest(self, topic: str, stamp_ns: int) -> tuple[int, Any] | None:
        """The message of a topic nearest to a time, if it is near enough."""
        near = [one for one in self._waiting[topic] if abs(one[0] - stamp_ns) <= self._slop_ns]
        return min(near, key=lambda one: abs(one[0] - stamp_ns), default=None)


def stamp_ns(message: Any) -> int:
    """The time of a message's header in nanoseconds."""
    stamp = message.header.stamp
    nanoseconds = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec
    return int(stamp.sec) * 1_000_000_000 + int(nanoseconds)
