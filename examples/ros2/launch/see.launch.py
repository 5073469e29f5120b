"""View a run in RViz: `ros2 launch outrider_demo see.launch.py`, with `outrider simulator` and `outrider ros2`."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    share = Path(get_package_share_directory("outrider_demo"))
    return LaunchDescription(
        [
            DeclareLaunchArgument("session", default_value=str(share / "session.json5")),
            SetEnvironmentVariable("RMW_IMPLEMENTATION", "rmw_zenoh_cpp"),
            SetEnvironmentVariable("ZENOH_SESSION_CONFIG_URI", LaunchConfiguration("session")),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(share / "rviz" / "outrider.rviz")],
                parameters=[{"use_sim_time": True}],
            ),
        ]
    )
