"""Messages as ROS has them, made from their published definitions."""

from typing import Any

import numpy as np

from remind_ros.bag import from_store
from remind_ros.definitions import add_types
from tests.cli import scenes

TYPES = add_types()
make = from_store(TYPES)


def header(stamp_ns: int = 0) -> Any:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id="camera")


def image(pixels: np.ndarray, encoding: str = "rgb8", stamp_ns: int = 0, padding: int = 0) -> Any:
    """An image whose rows are followed by `padding` bytes."""
    height, width = pixels.shape[:2]
    rows = np.frombuffer(pixels.tobytes(), np.uint8).reshape(height, -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    return make(
        "sensor_msgs/msg/Image", header=header(stamp_ns), height=height, width=width,
        encoding=encoding, is_bigendian=int(pixels.dtype.byteorder == ">"), step=rows.shape[1],
        data=rows.ravel(),
    )  # fmt: skip


def boxes(
    sides: list[tuple[float, float, float, float]], names: list[str], theta: float = 0.0
) -> Any:
    """Detections with one hypothesis each; sides are left, top, right, bottom."""
    found = []
    for (left, top, right, bottom), name in zip(sides, names, strict=True):
        position = make("vision_msgs/msg/Point2D", x=(left + right) / 2, y=(top + bottom) / 2)
        box = make(
            "vision_msgs/msg/BoundingBox2D",
            center=make("vision_msgs/msg/Pose2D", position=position, theta=theta),
            size_x=right - left, size_y=bottom - top,
        )  # fmt: skip
        results = [hypothesis(name, 0.75), hypothesis("other", 0.25)]
        found.append(
            make(
                "vision_msgs/msg/Detection2D",
                header=header(),
                results=results,
                bbox=box,
                id="",
            )
        )
    return make("vision_msgs/msg/Detection2DArray", header=header(), detections=found)


def hypothesis(class_id: str, score: float) -> Any:
    pose = make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    return make(
        "vision_msgs/msg/ObjectHypothesisWithPose",
        hypothesis=make("vision_msgs/msg/ObjectHypothesis", class_id=class_id, score=score),
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
    )


def scene(index: int) -> tuple[np.ndarray, np.ndarray]:
    """A picture and its instance map: two patterned squares that move slowly."""
    picture, numbers = scenes.picture(index, (1, 2))
    return picture, numbers.astype(np.uint16)
