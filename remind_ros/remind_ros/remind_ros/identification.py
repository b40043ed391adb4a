"""Identities for messages: everything that the node does but ROS itself.

Messages are made by a function of type name and fields, so that this module runs with those of
ROS, of `rosbags`, and of tests.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from remind_jax.config import load_config
from remind_jax.decision import NO_ID, Outcome
from remind_jax.errors import SourceError
from remind_jax.session.announcement import choose_after
from remind_jax.session.live import Tracker
from remind_jax.tracks import Tracks, title_of
from remind_ros.detections import read_detections
from remind_ros.images import read_instance_map, read_picture
from remind_ros.pairing import stamp_ns

MakeMessage = Callable[..., Any]  # (type name, **fields) -> message

# Constants of remind_ros_interfaces/msg/Identity.
LEFT_OUT, KNOWN, NEW, UNDECIDED = range(4)
_STATES = {
    Outcome.MATCH: KNOWN,
    Outcome.NEW: NEW,
    Outcome.AMBIGUOUS: UNDECIDED,
    Outcome.PROVISIONAL_NEW: UNDECIDED,
    Outcome.PROVISIONAL_PARENT: UNDECIDED,
}


@dataclasses.dataclass(frozen=True)
class Identified:
    """What is published of one image."""

    detections: Any  # vision_msgs/Detection2DArray
    identities: Any  # remind_ros_interfaces/Identities
    tracks: Tracks


def make_tracker(config: str, backbone: str, announce_after: int, has_detector: bool) -> Tracker:
    """The tracker of these settings; 0 for `announce_after` chooses it as `rj.run` does.

    Raises:
      RemindError: If one of them is unknown or does not fit.
    """
    settings = load_config(config)
    after = choose_after(announce_after, settings.input.announce_after, has_detector)
    return Tracker(settings, backbone, announce_after=after)


class Identification:
    """Takes images with detections, and says who is who."""

    def __init__(
        self,
        make: MakeMessage,
        tracker: Tracker | None = None,
        class_names: Mapping[str, str] | None = None,
    ) -> None:
        """Starts with an empty memory.

        Args:
          make: Makes a message of its type name (`std_msgs/msg/Header`) and all of its fields.
          tracker: With the configuration and the backbone to use; the default one if left out.
          class_names: What to call the class ids of detections; others keep their id.
        """
        self.tracker = Tracker() if tracker is None else tracker
        self.num_skipped = 0  # images, because the tracker was busy
        self._make = make
        self._class_names = dict(class_names or {})

    @property
    def num_objects(self) -> int:
        """Objects in memory that got an id."""
        return len(self.tracker.objects())

    def identify(self, image: Any, instance_map: Any = None, boxes: Any = None) -> Identified:
        """Takes the next image.

        Args:
          image: `sensor_msgs/Image` or `sensor_msgs/CompressedImage`.
          instance_map: `sensor_msgs/Image` of the same size, numbers of instances.
          boxes: `vision_msgs/Detection2DArray`; one of both may be None.

        Raises:
          SourceError: If a message cannot be used; memory is as before.
        """
        start = time.perf_counter()
        picture = read_picture(image)
        numbers = None if instance_map is None else read_instance_map(instance_map)
        size = (picture.shape[0], picture.shape[1])
        seen = read_detections(size, numbers, boxes, self._class_names)
        tracks = self.tracker.update(picture, seen, time_s=stamp_ns(image) / 1e9)
        step_ms = 1000 * (time.perf_counter() - start)
        rows = range(len(tracks))
        detections = self._make(
            "vision_msgs/msg/Detection2DArray",
            header=image.header,
            detections=[self._detection(tracks, row, image.header) for row in rows],
        )
        identities = self._make(
            "remind_ros_interfaces/msg/Identities",
            header=image.header,
            identities=[self._identity(tracks, row) for row in rows],
            objects_known=self.num_objects,
            images_skipped=self.num_skipped,
            step_ms=step_ms,
        )
        return Identified(detections, identities, tracks)

    def save(self, path: str | Path) -> str:
        """Writes the memory; says what was written.

        Raises:
          RemindError: If there is nothing to write, or it cannot be written.
        """
        self.tracker.save(path)
        return f"{self.num_objects} objects were written to {path}"

    def checkpoint(self, path: str | Path) -> str:
        """As `save`, of what changed, and not over what another program wrote.

        Raises:
          RemindError: If there is nothing to write, or it cannot be written.
        """
        self.tracker.checkpoint(path)
        return f"{self.num_objects} objects were written to {path}"

    def load(self, path: str | Path) -> str:
        """Goes on from a memory file; says what was read.

        Raises:
          RemindError: If it cannot be read, or does not fit; memory is as before.
        """
        self.tracker.load(path)
        return f"{self.num_objects} objects were read from {path}"

    def rename(self, object_id: str, name: str) -> str:
        """Calls an object by a name from now on; by its class and number again if it is empty.

        The name is part of the memory, and of its file.

        Raises:
          SourceError: If there is no object with this id, or it cannot have this name.
        """
        if not object_id.isdecimal() or len(object_id) > 18:
            raise SourceError(f"there is no object '{object_id}'; give the id of a detection")
        self.tracker.rename(int(object_id), name)
        return (
            f"object {object_id} is called '{name}'" if name else f"object {object_id} has no name"
        )

    def reset(self) -> str:
        """Forgets everything; says how much it was."""
        num = self.num_objects
        self.tracker.reset()
        return f"{num} objects were forgotten"

    def _detection(self, tracks: Tracks, row: int, header: Any) -> Any:
        """A detection with its identity.

        The first hypothesis is its class, with the confidence in the identity. An undecided one
        has no id; one hypothesis per object that it may be follows, `label id` and its score.
        """
        object_id = int(tracks.object_id[row])
        label = tracks.labels[row]
        confidence = float(tracks.shown_confidence(row) or 0.0)
        hypotheses = [(label, confidence)]
        if object_id == NO_ID:
            hypotheses += [
                (title_of(label, other, tracks.names), score)
                for other, score in _candidates(tracks, row)
            ]
        return self._make(
            "vision_msgs/msg/Detection2D",
            header=header,
            results=[self._hypothesis(name, score) for name, score in hypotheses],
            bbox=self._box(tracks.boxes[row]),
            id="" if object_id == NO_ID else str(object_id),
        )

    def _identity(self, tracks: Tracks, row: int) -> Any:
        object_id = int(tracks.object_id[row])
        candidates = _candidates(tracks, row) if object_id == NO_ID else []
        return self._make(
            "remind_ros_interfaces/msg/Identity",
            state=_STATES.get(Outcome(int(tracks.outcome[row])), LEFT_OUT),
            id="" if object_id == NO_ID else str(object_id),
            name=tracks.display_name(row),
            label=tracks.labels[row],
            confidence=float(tracks.shown_confidence(row) or 0.0),
            candidate_ids=[str(other) for other, _ in candidates],
            candidate_scores=np.array([score for _, score in candidates], np.float64),
            bbox=self._box(tracks.boxes[row]),
        )

    def _hypothesis(self, class_id: str, score: float) -> Any:
        make = self._make
        nowhere = make(
            "geometry_msgs/msg/Pose",
            position=make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
            orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        )
        return make(
            "vision_msgs/msg/ObjectHypothesisWithPose",
            hypothesis=make("vision_msgs/msg/ObjectHypothesis", class_id=class_id, score=score),
            pose=make(
                "geometry_msgs/msg/PoseWithCovariance", pose=nowhere, covariance=np.zeros(36)
            ),
        )

    def _box(self, box: np.ndarray) -> Any:
        make = self._make
        left, top, right, bottom = (float(side) for side in box)
        center = make("vision_msgs/msg/Point2D", x=(left + right) / 2, y=(top + bottom) / 2)
        return make(
            "vision_msgs/msg/BoundingBox2D",
            center=make("vision_msgs/msg/Pose2D", position=center, theta=0.0),
            size_x=right - left,
            size_y=bottom - top,
        )


def _candidates(tracks: Tracks, row: int) -> list[tuple[int, float]]:
    """The objects that an undecided detection may be, best first, with their scores."""
    pairs = zip(tracks.candidate_id[row], tracks.candidate_score[row], strict=True)
    return [(int(other), float(score)) for other, score in pairs if other != NO_ID]
