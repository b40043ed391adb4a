"""The node: subscriptions, publishers, services and parameters around `Identification`.

Images are answered in a thread of their own. While it is busy, only the newest complete image
waits; those that it replaces are skipped and counted, so that an answer is never late by more than
two images.
"""

from __future__ import annotations

import array
import importlib
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from rclpy.qos import qos_profile_sensor_data

from remind_jax.config import load_config
from remind_jax.errors import RemindError, SourceError
from remind_jax.session.live import Tracker
from remind_ros.identification import Identification
from remind_ros.pairing import Pairing, stamp_ns

_PARAMETERS: dict[str, Any] = {
    "config": "default",  # name or YAML file of remind-jax
    "backbone": "patch-statistics",
    "memory": "",  # file: read at the start if it exists, written by ~/save and at the end
    "compressed": False,  # whether images are sensor_msgs/CompressedImage
    "use_instances": False,  # instance maps in ~/instances
    "use_detections": True,  # vision_msgs/Detection2DArray in ~/detections_in
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
    """Publishes who is who in the images that its node subscribes to."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("remind")
        given = {
            name: self.node.declare_parameter(name, value).value
            for name, value in _PARAMETERS.items()
        }
        names = dict(zip(given["class_ids"], given["class_names"], strict=False))
        names.pop("", None)
        tracker = Tracker(load_config(given["config"]), given["backbone"])
        self._memory = given["memory"]
        self._identification = Identification(make_ros_message, tracker, names)
        self._lock = threading.Lock()  # of the tracker
        self._prepare(given)
        self._subscribe(given)
        self._outlets = {
            "detections": self._publisher("vision_msgs/msg/Detection2DArray", "~/detections"),
            "identities": self._publisher("remind_ros_interfaces/msg/Identities", "~/identities"),
        }
        self._serve("std_srvs/srv/Trigger", "~/reset", lambda _: self._identification.reset())
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
        self._worker = threading.Thread(target=self._answer_images, daemon=True)
        self._worker.start()

    def close(self) -> None:
        """Answers no more images, and keeps the memory if a file was named."""
        with self._changed:
            self._is_open = False
            self._changed.notify()
        self._worker.join()
        if self._memory and self._identification.tracker.num_objects:
            self.node.get_logger().info(self._identification.save(self._memory))

    def _prepare(self, given: dict[str, Any]) -> None:
        """Reads the memory that there is, and prepares programs if the size is known."""
        if self._memory:
            try:
                self.node.get_logger().info(self._identification.load(self._memory))
            except RemindError as error:
                self.node.get_logger().warning(f"starting with an empty memory: {error}")
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
        self._pairing = Pairing(tuple(kinds), round(1e9 * given["slop_s"]))
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

    def _path(self, request: Any) -> str:
        if not (request.path or self._memory):
            raise SourceError("name a path, or set the parameter 'memory'")
        return request.path or self._memory

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


def _type(kind: str) -> Any:
    package, group, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{group}"), name)


def main() -> None:
    """Runs the node until it is told to end."""
    rclpy.init()
    identity_node = IdentityNode()
    try:
        rclpy.spin(identity_node.node)
    except KeyboardInterrupt:
        pass
    finally:
        identity_node.close()
        identity_node.node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
