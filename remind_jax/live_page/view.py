"""What the live page shows; its threads draw and pack it, once per frame."""

from __future__ import annotations

import collections
import dataclasses
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from remind_jax.decision import NO_ID, Outcome
from remind_jax.frame import Frame
from remind_jax.outputs.drawing import encode_jpeg, fit_image, identity_color, to_hex
from remind_jax.outputs.gallery import crop_detection
from remind_jax.outputs.overlay import detection_color, draw_overlay
from remind_jax.outputs.run_records import Event, MemoryUse
from remind_jax.sources import LiveSource
from remind_jax.tracks import Tracks, title_of

MAX_OBJECTS = 500  # those unseen for longest leave the page, not the memory
MAX_SPANS = 100  # of one object
MAX_ROWS = 40  # of the timeline
MAX_LISTED = 100  # that are not in view
WINDOW_S = 120.0  # of the timeline
_GAP_S = 1.0  # shorter absences leave no gap in the timeline
_MAX_SIDE_PX = 1280  # of the picture shown
_QUALITY = 80
_FRESH_S = 10.0  # so old a picture of an object may be while it is in view
_MAX_CUT = 4  # pictures of objects per frame
_RECENT = 20  # frames that the speed is measured over


@dataclasses.dataclass
class _Object:
    """What is shown of one object."""

    label: str
    object_id: int  # as announced
    first_s: float  # in this run
    last_s: float  # NaN if it was not seen in this run
    num_frames: int = 0
    spans: collections.deque[tuple[float, float]] = dataclasses.field(
        default_factory=lambda: collections.deque(maxlen=MAX_SPANS)
    )
    picture: bytes | None = None
    pictured_s: float = -np.inf

    def title(self, names: Mapping[int, str]) -> str:
        """As beside its detections."""
        return title_of(self.label, self.object_id, names)

    @property
    def color(self) -> str:
        """As of its detections."""
        return to_hex(identity_color(self.object_id))

    def see(self, time_s: float) -> None:
        """Takes note of a detection."""
        self.last_s = time_s
        self.num_frames += 1
        if self.spans and time_s - self.spans[-1][1] <= _GAP_S:
            self.spans[-1] = (self.spans[-1][0], time_s)
        else:
            self.spans.append((time_s, time_s))


class LiveView:
    """The newest frame and the objects so far, for the threads of a page."""

    def __init__(
        self,
        title: str,
        source: LiveSource | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._title, self._source, self._clock = title, source, clock
        self._changed, self._drawing = threading.Condition(), threading.Lock()
        self._version, self._num_shown, self._is_over = 0, 0, False
        self._frame: tuple[np.ndarray | None, Tracks] | None = None
        self._memory: MemoryUse | None = None
        self._objects: dict[int, _Object] = {}  # by their ids
        self._earlier: dict[int, _Object] = {}  # the same of those not seen in this run
        self._names: Mapping[int, str] = {}
        self._in_view: set[int] = set()
        self._arrived = self._now_s = 0.0
        self._shown_at = collections.deque[float](maxlen=_RECENT)
        self._drawn: tuple[int, bytes] | None = None

    def remember(self, objects: Sequence[Any]) -> None:
        """Takes what is known before the first frame, as `Tracker.objects` tells it."""
        with self._changed:
            latest = sorted(objects, key=lambda one: one.last, reverse=True)
            self._earlier = {
                one.object_id: _Object(one.label, one.object_id, np.nan, np.nan, one.num_frames)
                for one in latest
            }
            self._names = {one.object_id: one.name for one in latest}

    def show(
        self,
        frame: Frame,
        tracks: Tracks,
        events: Sequence[Event] = (),
        memory: MemoryUse | None = None,
    ) -> None:
        """Takes the newest frame, what happened in it, and what the memory holds since."""
        age_s = 0.0 if self._source is None else self._source.age_s(frame)
        with self._changed:
            now = self._clock()
            for event in events:
                if event.kind == "merged":
                    self._merge(*event.objects)
                elif event.kind == "forgotten":
                    for gone in event.objects:
                        self._objects.pop(gone, None)
                        self._earlier.pop(gone, None)
            self._in_view = set()
            for row, object_id in enumerate(tracks.object_id.tolist()):
                if object_id != NO_ID:
                    self._see(object_id, tracks.labels[row], frame.time_s)
            self._picture_some(frame, tracks)
            self._forget_some()
            self._frame, self._memory = (frame.image, tracks), memory
            self._names = tracks.names
            self._arrived, self._now_s = now - age_s, frame.time_s
            self._shown_at.append(now)
            self._num_shown += 1
            self._version += 1
            self._changed.notify_all()

    def end(self) -> None:
        """Says that no more frames will come."""
        with self._changed:
            self._is_over = True
            self._version += 1
            self._changed.notify_all()

    def wait(self, after: int, timeout_s: float) -> None:
        """Returns when something newer than a version is there, or the time is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._version != after, timeout_s)

    def state(self) -> dict[str, Any]:
        """What the page writes, as `json` can."""
        with self._changed:
            tracks = None if self._frame is None else self._frame[1]
            latest = sorted(self._objects.items(), key=lambda item: -item[1].last_s)
            absent = [(key, one) for key, one in latest if key not in self._in_view]
            rows = sorted((one for _, one in latest[:MAX_ROWS]), key=lambda one: one.first_s)
            return {
                "version": self._version,
                "title": self._title,
                "frames": self._num_shown,
                **self._say_source(),
                "age_ms": None if not self._is_live else 1000 * (self._clock() - self._arrived),
                "fps": self._measure_speed(),
                "num_objects": len(self._objects) + len(self._earlier),
                "memory": None if self._memory is None else msgspec.to_builtins(self._memory),
                "in_view": [] if tracks is None else self._list_rows(tracks),
                "remembered": [
                    {
                        "key": key if one.picture is not None else None,
                        "name": one.title(self._names),
                        "color": one.color,
                        "unseen_s": None if np.isnan(one.last_s) else self._now_s - one.last_s,
                        "frames": one.num_frames,
                    }
                    for key, one in [*absent, *self._earlier.items()][:MAX_LISTED]
                ],
                "timeline": {
                    "from_s": max(0.0, self._now_s - WINDOW_S),
                    "to_s": max(self._now_s, 1e-3),
                    "rows": [
                        {
                            "name": one.title(self._names),
                            "color": one.color,
                            "spans": [s for s in one.spans if s[1] >= self._now_s - WINDOW_S],
                        }
                        for one in rows
                    ],
                },
            }

    def picture(self) -> bytes | None:
        """The newest frame with its identities as JPEG; None before the first."""
        with self._drawing:  # others wait for the same picture, the tracker does not
            with self._changed:
                version, frame = self._version, self._frame
            if frame is None:
                return None
            if self._drawn is None or self._drawn[0] != version:
                image = draw_overlay(*frame)
                scale = min(1.0, _MAX_SIDE_PX / max(image.shape[:2]))
                height, width = (max(1, round(scale * side)) for side in image.shape[:2])
                self._drawn = version, encode_jpeg(fit_image(image, height, width), _QUALITY)
            return self._drawn[1]

    def picture_of(self, key: int) -> bytes | None:
        """A view of an object as JPEG, by its id."""
        with self._changed:
            one = self._objects.get(key)
            return None if one is None else one.picture

    @property
    def _is_live(self) -> bool:
        return self._source is not None and self._frame is not None and not self._is_over

    def _say_source(self) -> dict[str, Any]:
        if self._source is None:
            state = "ended" if self._is_over else "recorded"
            return {"source": state, "shown": self._title, "arrived": None, "missed": None}
        status = self._source.status()
        return {
            "source": "ended" if self._is_over else status.state,
            "shown": status.shown,
            "silent_s": status.silent_s,
            "arrived": status.num_arrived,
            "missed": status.num_missed,
        }

    def _measure_speed(self) -> float | None:
        if len(self._shown_at) < 2:
            return None
        return (len(self._shown_at) - 1) / max(1e-6, self._shown_at[-1] - self._shown_at[0])

    def _list_rows(self, tracks: Tracks) -> list[dict[str, Any]]:
        return [
            {
                "name": tracks.display_name(row),
                "color": to_hex(detection_color(tracks, row)),
                "outcome": Outcome(int(tracks.outcome[row])).name.lower().replace("_", " "),
                "confidence": tracks.shown_confidence(row),
            }
            for row in range(len(tracks))
        ]

    def _see(self, object_id: int, label: str, time_s: float) -> None:
        earlier = self._earlier.pop(object_id, None)
        if object_id not in self._objects:
            self._objects[object_id] = _Object(label, object_id, time_s, time_s)
        one = self._objects[object_id]
        one.num_frames += 0 if earlier is None else earlier.num_frames
        one.see(time_s)
        self._in_view.add(object_id)

    def _merge(self, gone: int, kept: int) -> None:
        former = self._objects.pop(gone, None)
        if former is None:
            return
        one = self._objects.setdefault(kept, former)
        if one is former:
            one.object_id = kept
        else:
            spans = sorted([*former.spans, *one.spans])
            one.spans = collections.deque(spans, maxlen=MAX_SPANS)
            one.first_s = min(one.first_s, former.first_s)
            one.num_frames += former.num_frames

    def _picture_some(self, frame: Frame, tracks: Tracks) -> None:
        """Cuts out those whose pictures are the oldest; only a few, since the tracker waits."""
        if frame.image is None:
            return
        due = [
            (self._objects[key], row)
            for row, key in enumerate(tracks.object_id.tolist())
            if key != NO_ID and frame.time_s - self._objects[key].pictured_s > _FRESH_S
        ]
        due.sort(key=lambda pair: pair[0].pictured_s)
        image = fit_image(frame.image, *tracks.frame_size)
        for one, row in due[:_MAX_CUT]:
            one.picture = encode_jpeg(crop_detection(image, tracks, row), _QUALITY)
            one.pictured_s = frame.time_s

    def _forget_some(self) -> None:
        while len(self._objects) > MAX_OBJECTS:
            oldest = min(self._objects, key=lambda key: self._objects[key].last_s)
            del self._objects[oldest]
