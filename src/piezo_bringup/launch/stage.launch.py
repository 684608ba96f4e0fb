# SPDX-License-Identifier: BSD-3-Clause
"""The simulated stage and the recorder."""

from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    """Describe what is started, and the arguments."""
    default = PathJoinSubstitution(
        [FindPackageShare("piezo_bringup"), "config", "simulated_stage.yaml"])
    settings = {
        "namespace": LaunchConfiguration("namespace"),
        "parameters": [LaunchConfiguration("parameters")],
        "output": "screen",
    }
    return LaunchDescription([
        DeclareLaunchArgument("namespace", default_value="", description="Of all nodes."),
        DeclareLaunchArgument("parameters", default_value=default,
                              description="Parameter file (YAML)."),
        DeclareLaunchArgument(
            "discovery_range", default_value="LOCALHOST",
            description="LOCALHOST, or SUBNET to let other machines command the stage."),
        SetEnvironmentVariable(
            "ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery_range")),
        Node(package="piezo_sim", executable="stage_sim", **settings),
        Node(package="piezo_recorder", executable="recorder", **settings),
    ])
