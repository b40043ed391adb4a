"""A run for Rerun's viewer: into a file, or live to a viewer that is open.

| entity | what it shows |
| --- | --- |
| `camera/image` | the frame |
| `camera/masks`, `camera/boxes` | detections in the colors of their identities |
| `memory/CLASS/ID` | the last clear view of an object, its confidence, and its class and number |
| `memory/objects` | how many objects were met so far |
| `events` | what happened: objects met first, known ones seen again after a while |

Time lines: `frame`, the number of the processed frame, and `time`, that of the source.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from remind_jax.decision import NO_ID
from remind_jax.errors import ConfigError, OutputError
from remind_jax.frame import Frame
from remind_jax.masks.run_length import decode_mask
from remind_jax.outputs.drawing import encode_jpeg, identity_color
from remind_jax.outputs.overlay import detection_color
from remind_jax.outputs.presence import MIN_ABSENCE_FRAMES
from remind_jax.printing.terminal import printable
from remind_jax.tracks import Tracks, title_of

LIVE_PREFIX = "rerun+"  # of the addresses of viewers: rerun+http://127.0.0.1:9876/proxy

_JPEG_QUALITY = 85
_VIEW_PX = 128  # longer side of an object's view
_UNDECIDED = 1  # class of masks without identity; object n has class n + _FIRST
_FIRST = 2


class RerunRecord(contextlib.AbstractContextManager):
    """Logs a run frame by frame."""

    def __init__(self, target: str | Path, name: str) -> None:
        """Opens the file, or finds the viewer.

        Args:
          target: File to write (`.rrd`), or the address of a viewer (`rerun+http://...`).
          name: Of the run, as the viewer shows it.

        Raises:
          ConfigError: If Rerun is not installed.
          OutputError: If the file cannot be written or nobody answers at the address.
        """
        try:
            import rerun
        except ImportError as error:
            raise ConfigError(
                "Rerun is not installed; install it with: pip install 'remind-jax[viewers]'"
            ) from error
        self._rerun, self._target = rerun, str(target)
        self._stream = rerun.RecordingStream("remind-jax", recording_id=None)
        try:
            if self._target.startswith(LIVE_PREFIX):
                self._stream.connect_grpc(self._target)
            else:
                Path(target).touch()  # Rerun itself fails in the background
                self._stream.save(target)
        except (OSError, RuntimeError, ValueError) as error:
            raise OutputError(f"{self._target} cannot be opened for Rerun: {error}") from error
        self._stream.send_recording_name(name)
        self._stream.send_blueprint(self._blueprint())
        self._last_seen: dict[int, int] = {}  # frame, by object
        self._views: dict[int, float] = {}  # area of the view that is shown, by object

    def __exit__(self, *_: object) -> None:
        self._stream.flush()
        self._stream.disconnect()

    def add(self, frame: Frame, tracks: Tracks) -> None:
        """Logs one frame."""
        self._stream.set_time("frame", sequence=tracks.frame_index)
        self._stream.set_time("time", duration=float(tracks.time_s))
        if frame.image is not None:
            self._log("camera/image", self._rerun.EncodedImage(
                contents=encode_jpeg(frame.image, _JPEG_QUALITY), media_type="image/jpeg"
            ))  # fmt: skip
        self._log_detections(tracks)
        for row in np.flatnonzero(tracks.object_id != NO_ID):
            self._log_object(frame, tracks, int(row))
        self._log("memory/objects", self._rerun.Scalars(len(self._last_seen)))

    def _log_detections(self, tracks: Tracks) -> None:
        """Masks and boxes; a mask of a smaller object lies above one of a larger one."""
        rerun, classes = self._rerun, _classes(tracks)
        new = set(tracks.object_id[tracks.object_id != NO_ID].tolist()) - set(self._last_seen)
        if new or not self._last_seen:
            known = sorted(set(self._last_seen) | new)
            shown = [(_UNDECIDED, "undecided", (225, 228, 233))]
            shown += [(number + _FIRST, str(number), identity_color(number)) for number in known]
            self._log("camera", rerun.AnnotationContext([(0, "", (0, 0, 0, 0)), *shown]))
        numbers = np.zeros(tracks.frame_size, np.uint16)
        for row in np.argsort(-tracks.areas, kind="stable"):
            numbers[decode_mask(tracks.rles[row]).astype(bool)] = classes[row]
        self._log("camera/masks", rerun.SegmentationImage(numbers, opacity=0.5))
        self._log(
            "camera/boxes",
            rerun.Boxes2D(
                array=tracks.boxes.astype(np.float32),
                array_format=rerun.Box2DFormat.XYXY,
                labels=[printable(tracks.display_name(row)) for row in range(len(tracks))],
                colors=[detection_color(tracks, row) for row in range(len(tracks))],
                class_ids=classes,
            ),
        )

    def _log_object(self, frame: Frame, tracks: Tracks, row: int) -> None:
        rerun, number = self._rerun, int(tracks.object_id[row])
        label = printable(tracks.labels[row])
        where = f"memory/{rerun.escape_entity_path_part(label)}/{number}"
        title = printable(title_of(tracks.labels[row], number, tracks.names))
        before = self._last_seen.get(number)
        self._last_seen[number] = tracks.frame_index
        if before is None:
            self._log(where, rerun.TextDocument(title))
            self._log("events", rerun.TextLog(f"{title} is met first"))
        elif (absent := tracks.frame_index - before - 1) >= MIN_ABSENCE_FRAMES:
            self._log("events", rerun.TextLog(f"{title} is seen again after {absent} frames"))
        if (confidence := tracks.shown_confidence(row)) is not None:
            self._log(f"{where}/confidence", rerun.Scalars(confidence))
        area = float(tracks.areas[row])
        # A view is logged again only if it is clearly larger, so that files stay small.
        if frame.image is not None and area > 1.5 * self._views.get(number, 0.0):
            self._views[number] = area
            view = encode_jpeg(_crop(frame.image, tracks.boxes[row]), _JPEG_QUALITY)
            self._log(f"{where}/view", rerun.EncodedImage(contents=view, media_type="image/jpeg"))

    def _log(self, entity: str, what: Any) -> None:
        self._stream.log(entity, what)

    def _blueprint(self) -> Any:
        """Picture beside events and confidences."""
        from rerun import blueprint

        return blueprint.Blueprint(
            blueprint.Horizontal(
                blueprint.Spatial2DView(origin="camera", name="who is who"),
                blueprint.Vertical(
                    blueprint.TimeSeriesView(origin="memory", name="memory"),
                    blueprint.TextLogView(origin="events", name="events"),
                ),
                column_shares=[2, 1],
            )
        )


def _classes(tracks: Tracks) -> np.ndarray:
    """Class of each detection in the annotation context."""
    has_id = tracks.object_id != NO_ID
    return np.where(has_id, tracks.object_id + _FIRST, _UNDECIDED).astype(np.uint16)


def _crop(image: np.ndarray, box: np.ndarray) -> np.ndarray:
    """What lies in a box, no larger than a view."""
    left, top, right, bottom = (round(float(side)) for side in box)
    part = image[max(top, 0) : max(bottom, top + 1), max(left, 0) : max(right, left + 1)]
    scale = min(1.0, _VIEW_PX / max(part.shape[:2]))
    size = (max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale)))
    return cv2.resize(part, size, interpolation=cv2.INTER_AREA)
