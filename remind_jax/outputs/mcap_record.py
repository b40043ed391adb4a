"""A run for Foxglove: an MCAP file of its standard messages.

Times are those of the source: from 1970 on of recordings, the clock's of what is live.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from remind_jax.decision import NO_ID, Outcome
from remind_jax.errors import ConfigError, OutputError
from remind_jax.frame import Frame
from remind_jax.masks.run_length import cut_masks
from remind_jax.outputs.drawing import encode_jpeg
from remind_jax.outputs.overlay import detection_color, find_contours
from remind_jax.printing.terminal import printable
from remind_jax.tracks import Tracks

_JPEG_QUALITY = 85
_FRAME_ID = "camera"
_WHOLE, _NUMBER, _TEXT = ({"type": kind} for kind in ("integer", "number", "string"))
_DETECTION = {
    "id": {"type": ["integer", "null"]},
    "name": _TEXT,
    "label": _TEXT,
    "outcome": _TEXT,
    "confidence": {"type": ["number", "null"]},
    "candidates": {"type": "array", "items": _WHOLE},
    "box": {"type": "array", "items": _NUMBER},
}
_DETECTIONS = {"type": "array", "items": {"type": "object", "properties": _DETECTION}}
_TRACKS_SCHEMA = {
    "title": "remind.Tracks",
    "type": "object",
    "properties": {"frame": _WHOLE, "name": _TEXT, "detections": _DETECTIONS},
}


class McapRecord(contextlib.AbstractContextManager):
    """Writes a run frame by frame."""

    def __init__(self, path: str | Path, opened_s: float = 0.0) -> None:
        """Writes nothing yet.

        Args:
          opened_s: Time 0 of the source, in seconds from 1970 on.

        Raises:
          ConfigError: If Foxglove's library is not installed.
        """
        try:
            import foxglove
            from foxglove import channels, messages
        except ImportError as error:
            raise ConfigError(
                "Foxglove's library is not installed; install it with: "
                "pip install 'remind-jax[viewers]'"
            ) from error
        self._messages, self._open, self._path = messages, foxglove.open_mcap, path
        self._opened_s = opened_s
        self._context = context = foxglove.Context()  # its channels end with it
        self._image = channels.CompressedImageChannel("/camera/image", context=context)
        self._annotations = channels.ImageAnnotationsChannel("/remind/annotations", context=context)
        self._tracks = foxglove.Channel("/remind/tracks", schema=_TRACKS_SCHEMA, context=context)

    def __enter__(self) -> McapRecord:
        """Opens the file; one that is there is replaced.

        Raises:
          OutputError: If the file cannot be written.
        """
        try:
            self._writer = self._open(self._path, allow_overwrite=True, context=self._context)
        except (OSError, RuntimeError, ValueError) as error:
            raise OutputError(f"{self._path} cannot be written: {error}") from error
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def add(self, frame: Frame, tracks: Tracks) -> None:
        """Writes one frame."""
        time_ns = round(1e9 * (self._opened_s + max(0.0, float(tracks.time_s))))
        stamp = self._messages.Timestamp(time_ns // 1_000_000_000, time_ns % 1_000_000_000)
        if frame.image is not None:
            data = encode_jpeg(frame.image, _JPEG_QUALITY)
            self._image.log(
                self._messages.CompressedImage(
                    timestamp=stamp, frame_id=_FRAME_ID, data=data, format="jpeg"
                ),
                log_time=time_ns,
            )
        rows = range(len(tracks))
        self._annotations.log(
            self._messages.ImageAnnotations(
                points=[line for row in rows for line in self._outlines(tracks, row, stamp)],
                texts=[self._name(tracks, row, stamp) for row in rows],
            ),
            log_time=time_ns,
        )
        self._tracks.log(
            {
                "frame": tracks.frame_index,
                "name": printable(tracks.name),
                "detections": [_facts(tracks, row) for row in rows],
            },
            log_time=time_ns,
        )

    def _outlines(self, tracks: Tracks, row: int, stamp: Any) -> list[Any]:
        """One closed line for each part of the mask."""
        messages = self._messages
        return [
            messages.PointsAnnotation(
                timestamp=stamp,
                type=messages.PointsAnnotationType.LineLoop,
                points=[messages.Point2(x=float(x), y=float(y)) for x, y in part[:, 0]],
                outline_color=self._color(tracks, row),
                thickness=2.0,
            )
            for part in find_contours(cut_masks([tracks.rles[row]], tracks.frame_size))
        ]

    def _name(self, tracks: Tracks, row: int, stamp: Any) -> Any:
        left, top = (float(side) for side in tracks.boxes[row, :2])
        return self._messages.TextAnnotation(
            timestamp=stamp,
            position=self._messages.Point2(x=left, y=top),
            text=printable(tracks.display_name(row)),
            font_size=12.0,
            text_color=self._messages.Color(r=0.0, g=0.0, b=0.0, a=1.0),
            background_color=self._color(tracks, row),
        )

    def _color(self, tracks: Tracks, row: int) -> Any:
        red, green, blue = (channel / 255 for channel in detection_color(tracks, row))
        return self._messages.Color(r=red, g=green, b=blue, a=1.0)


def _facts(tracks: Tracks, row: int) -> dict[str, Any]:
    object_id = int(tracks.object_id[row])
    return {
        "id": None if object_id == NO_ID else object_id,
        "name": printable(tracks.display_name(row)),
        "label": printable(tracks.labels[row]),
        "outcome": Outcome(int(tracks.outcome[row])).name.lower(),
        "confidence": tracks.shown_confidence(row),
        "candidates": [int(other) for other in tracks.candidate_id[row] if other != NO_ID],
        "box": [float(side) for side in tracks.boxes[row]],
    }
