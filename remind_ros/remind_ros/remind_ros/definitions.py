"""Message types for programs that run without ROS, as `rosbags` takes them.

Those of `vision_msgs` are of its releases for ROS 2 Humble and later.
"""

from __future__ import annotations

from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

DEFINITIONS = {
    "vision_msgs/msg/Point2D": "float64 x\nfloat64 y",
    "vision_msgs/msg/Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "vision_msgs/msg/BoundingBox2D": ("vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y"),
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/Detection2D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox2D bbox\nstring id"
    ),
    "vision_msgs/msg/Detection2DArray": (
        "std_msgs/Header header\nvision_msgs/Detection2D[] detections"
    ),
    "remind_ros_interfaces/msg/Identity": (
        "uint8 LEFT_OUT=0\nuint8 KNOWN=1\nuint8 NEW=2\nuint8 UNDECIDED=3\n"
        "uint8 state\nstring id\nstring name\nstring label\nfloat64 confidence\n"
        "string[] candidate_ids\nfloat64[] candidate_scores\nvision_msgs/BoundingBox2D bbox"
    ),
    "remind_ros_interfaces/msg/Identities": (
        "std_msgs/Header header\nremind_ros_interfaces/Identity[] identities\n"
        "uint32 objects_known\nuint32 images_skipped\nfloat64 step_ms"
    ),
}


def add_types(store: Typestore | None = None) -> Typestore:
    """A store of types that knows those above as well; one of ROS 2 Humble if none is given."""
    store = get_typestore(Stores.ROS2_HUMBLE) if store is None else store
    new: dict[str, Any] = {}
    for name, text in DEFINITIONS.items():
        if name not in store.types:
            new.update(get_types_from_msg(text, name))
    store.register(new)
    return store
