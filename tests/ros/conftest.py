"""The ROS package lies outside the wheel; its tests run without ROS."""

import sys
from pathlib import Path

ROS = Path(__file__).resolve().parents[2] / "remind_ros"

sys.path.insert(0, str(ROS / "remind_ros"))
