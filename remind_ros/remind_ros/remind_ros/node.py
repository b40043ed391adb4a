"""The node: subscriptions, publishers, services and parameters around `Identification`.

Images are answered in a thread of their own. While it is busy, only the newest complete image
waits; those that it replaces are skipped and counted, so that an answer is never late by more than
two images.
"""

from __future__ import annotations

import array
import importlib
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.qos import qos_profile_sensor_data

from remind_jax.errors import OutputError, RemindError, SourceError
from remind_jax.files import as_path
from remind_ros.identification import Identification, make_tracker
from remind_ros.pairing import MOST_WAITING, Pairing, slop_in_ns, stamp_ns

_PARAMETERS: dict[str, Any] = {
    "config": "default",  # name or YAML file of remind-jax
    "backbone": "patch-statistics",
    "memory": "",  # file: read at the start if it exists, written by ~/save and at the end, and
    "checkpoint_s": 30.0,  # every so many seconds in between; 0.0 for the end alone
    "compressed": False,  # whether images are sensor_msgs/CompressedImage
    "use_instances": False,  # instance maps in ~/instances
    "use_detections": True,  # vision_msgs/Detection2DArray in ~/detections_in
    "announce_after": 0,  # detections until an object gets its id; 0 chooses
    "slop_s": 0.01,  # between stamps of one image
    "class_ids": [""],  # ids of the detector, and
    "class_names": [""],  # what to call each of them
    "image_width": 0,  # prepares the programs before the first image
    "image_height": 0,
}


def make_ros_message(kind: str, **fields: Any) -> Any:
    """Makes a message of ROS; arrays become what its fields of variable length take."""
    package, _, name = kind.split("/")
    cls = getattr(importlib.import_module(f"{package}.msg"), name)
    declared = cls.get_fields_and_field_types()
    for field, value in fields.items():
        if isinstance(value, np.ndarray) and declared[field].startswith("sequence"):
            fields[field] = array.array(value.dtype.char, value.tolist())
    return cls(**fields)


class IdentityNode:
    """Publishes who is who in the images that its node subscribes to.

    Attributes:
      has_failed: Whether it ended by an error that nobody foresaw.
    """

    def __init__(self) -> None:
        self.node = rclpy.create_node("remind")
        given = {
            name: self.node.declare_parameter(name, value).value
            for name, value in _PARAMETERS.items()
        }
        if len(given["class_ids"]) != len(given["class_names"]):
            raise SourceError("class_ids and class_names differ in length; give each id its name")
        names = dict(zip(given["class_ids"], given["class_names"], strict=True))
        names.pop("", None)
        tracker = make_tracker(
            given["config"], given["backbone"], given["announce_after"], given["use_detections"]
        )
        self._memory, self._checkpoint_s = given["memory"], given["checkpoint_s"]
        self._kept_at = time.monotonic()
        self.has_failed = False
        self._identification = Identification(make_ros_message, tracker, names)
        self._lock = threading.Lock()  # of the tracker
        self._prepare(given)
        self._subscribe(given)
        self._outlets = {
            "detections": self._publisher("vision_msgs/msg/Detection2DArray", "~/detections"),
            "identities": self._publisher("remind_ros_interfaces/msg/Identities", "~/identities"),
        }
        self._serve("std_srvs/srv/Trigger", "~/reset", lambda _: self._reset())
        use, rename = (
            "remind_ros_interfaces/srv/UseMemory",
            "remind_ros_interfaces/srv/RenameObject",
        )
        self._serve(use, "~/save", lambda given: self._identification.save(self._path(given)))
        self._serve(use, "~/load", lambda given: self._identification.load(self._path(given)))
        self._serve(rename, "~/rename", lambda to: self._identification.rename(to.id, to.name))
        self._next: dict[str, Any] | None = None
        self._changed = threading.Condition()
        self._is_open = True
        self._worker = threading.Thread(target=self._work, daemon=True)
        self._worker.start()

    def close(self) -> None:
        """Answers no more images, and keeps the memory if a file was named."""
        with self._changed:
            self._is_open = False
            self._changed.notify()
        self._worker.join()
        if not self._memory or self._identification.tracker.state is None:
            return
        try:
            self.node.get_logger().info(self._identification.checkpoint(self._memory))
        except OutputError as error:
            told = self._identification.save(self._aside())
            self.node.get_logger().error(f"{error}; {told}")

    def _prepare(self, given: dict[str, Any]) -> None:
        """Reads the memory that there is, and prepares programs if the size is known."""
        if self._memory and as_path(self._memory, "the memory file", OutputError).exists():
            self.node.get_logger().info(self._identification.load(self._memory))
        elif self._memory:
            self.node.get_logger().info(f"starting with an empty memory: no file {self._memory}")
        size = (given["image_height"], given["image_width"])
        if all(size):
            seconds = self._identification.tracker.warm_up(size)
            self.node.get_logger().info(f"ready for {size[1]}x{size[0]} after {seconds:.1f} s")

    def _subscribe(self, given: dict[str, Any]) -> None:
        image = (
            "sensor_msgs/msg/CompressedImage" if given["compressed"] else "sensor_msgs/msg/Image"
        )
        kinds = {"~/image": image}
        if given["use_instances"]:
            kinds["~/instances"] = "sensor_msgs/msg/Image"
        if given["use_detections"]:
            kinds["~/detections_in"] = "vision_msgs/msg/Detection2DArray"
        if len(kinds) == 1:
            raise SourceError("set use_instances, use_detections, or both")
        self._pairing = Pairing(tuple(kinds), slop_in_ns(given["slop_s"]))
        for topic, kind in kinds.items():
            self.node.create_subscription(
                _type(kind), topic, self._receiver(topic), qos_profile_sensor_data
            )

    def _receiver(self, topic: str) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            try:
                sets = self._pairing.add(topic, stamp_ns(message), message)
            except SourceError as error:
                self.node.get_logger().warning(f"left out: {error}", throttle_duration_sec=10.0)
                return
            if self._pairing.is_full:
                self.node.get_logger().warning(
                    f"messages of '{topic}' go unanswered: nothing of the other topics has their "
                    f"stamps (see 'slop_s'), or it comes {MOST_WAITING} messages later",
                    throttle_duration_sec=10.0,
                )
            for found in sets:
                with self._changed:
                    self._identification.num_skipped += self._next is not None
                    self._next = found
                    self._changed.notify()

        return receive

    def _publisher(self, kind: str, topic: str) -> Any:
        return self.node.create_publisher(_type(kind), topic, 10)

    def _serve(self, kind: str, topic: str, do: Callable[[Any], str]) -> None:
        """Offers a service whose answer says whether it was done, and what."""

        def answer(request: Any, response: Any) -> Any:
            try:
                with self._lock:
                    response.message, response.success = do(request), True
            except RemindError as error:
                response.message, response.success = str(error), False
            return response

        self.node.create_service(_type(kind), topic, answer)

    def _reset(self) -> str:
        """Forgets everything; the file that the next start would read is laid aside."""
        told = self._identification.reset()
        file = Path(self._memory)
        if self._memory and file.exists():
            told += f"; what '{file}' knew is in '{file.rename(self._aside())}'"
        return told

    def _aside(self) -> str:
        return f"{self._memory}.{int(time.time())}"

    def _path(self, request: Any) -> str:
        if not (request.path or self._memory):
            raise SourceError("name a path, or set the parameter 'memory'")
        return request.path or self._memory

    def _work(self) -> None:
        """Answers images; an error that nobody foresaw ends the node, so that it is seen."""
        try:
            self._answer_images()
        except Exception:
            if rclpy.ok():  # else the node ends already, and nothing can be published any more
                self.has_failed = True
                self.node.get_logger().fatal(traceback.format_exc())
                rclpy.try_shutdown()

    def _checkpoint(self) -> None:
        """Writes the memory if it is time to."""
        due = self._kept_at + self._checkpoint_s
        if not self._memory or self._checkpoint_s <= 0 or time.monotonic() < due:
            return
        try:
            with self._lock:
                self._identification.checkpoint(self._memory)
        except RemindError as error:
            self.node.get_logger().error(f"the memory was not kept: {error}")
        self._kept_at = time.monotonic()

    def _answer_images(self) -> None:
        """Answers the newest image, over and over."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._next is not None or not self._is_open)
                if not self._is_open:
                    return
                found, self._next = self._next, None
            assert found is not None
            parts = [found.get(topic) for topic in ("~/image", "~/instances", "~/detections_in")]
            try:
                with self._lock:
                    answer = self._identification.identify(*parts)
            except RemindError as error:
                self.node.get_logger().warning(
                    f"image left out: {error}", throttle_duration_sec=1.0
                )
                continue
            self._outlets["detections"].publish(answer.detections)
            self._outlets["identities"].publish(answer.identities)
            self._checkpoint()


def _type(kind: str) -> Any:
    package, group, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{group}"), name)


def main() -> int:
    """Runs the node until it is told to end; returns its exit code."""
    rclpy.init()
    try:
        identity_node = IdentityNode()
        try:
            rclpy.spin(identity_node.node)
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        finally:
            identity_node.close()
            identity_node.node.destroy_node()
    except RemindError as error:
        get_logger("remind").fatal(str(error))
        return 1
    finally:
        rclpy.try_shutdown()
    return int(identity_node.has_failed)


if __name__ == "__main__":
    raise SystemExit(main())
