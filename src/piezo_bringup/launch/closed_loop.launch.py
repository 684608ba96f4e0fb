# SPDX-License-Identifier: BSD-3-Clause
"""The whole suite: stage and recorder, identification and controller, and a monitor if asked."""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    """Describe what is started; the other arguments are those of stage.launch.py."""
    stage = PathJoinSubstitution([FindPackageShare("piezo_bringup"), "launch", "stage.launch.py"])
    data_root = {"data_root": ParameterValue(LaunchConfiguration("data_root"), value_type=str)}
    settings = {
        "namespace": LaunchConfiguration("namespace"),
        "parameters": [data_root, LaunchConfiguration("parameters")],
        "output": "screen",
    }
    return LaunchDescription([
        DeclareLaunchArgument(
            "monitor", default_value="false",
            description="Whether the model runs in parallel, to report changes of the stage."),
        IncludeLaunchDescription(PythonLaunchDescriptionSource(stage)),
        Node(package="piezo_identification", executable="identification", **settings),
        Node(package="piezo_controller", executable="controller", **settings),
        Node(package="piezo_identification", executable="monitor",
             condition=IfCondition(LaunchConfiguration("monitor")), **settings),
    ])
