"""Starts the node with the parameters of config/identify.yaml; topics are remapped here."""

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description():
    """The description that `ros2 launch` runs."""
    share = get_package_share_directory("remind_ros")
    arguments = {
        "image": "/camera/image_raw",
        "detections": "/detector/detections",
        "instances": "/detector/instances",
        "params": f"{share}/config/identify.yaml",
    }
    node = Node(
        package="remind_ros",
        executable="identify",
        name="remind",
        parameters=[LaunchConfiguration("params")],
        remappings=[
            ("~/image", LaunchConfiguration("image")),
            ("~/detections_in", LaunchConfiguration("detections")),
            ("~/instances", LaunchConfiguration("instances")),
        ],
    )
    declared = [
        DeclareLaunchArgument(name, default_value=value) for name, value in arguments.items()
    ]
    return LaunchDescription([*declared, node])
