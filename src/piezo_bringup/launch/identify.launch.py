# SPDX-License-Identifier: BSD-3-Clause
"""Identify a stage: its nodes, the whole sequence of experiments, and the end of all."""

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    IncludeLaunchDescription,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    """Describe what is started; the other arguments are those of stage.launch.py."""
    stage = PathJoinSubstitution([FindPackageShare("piezo_bringup"), "launch", "stage.launch.py"])
    namespace = LaunchConfiguration("namespace")
    data_root = {"data_root": ParameterValue(LaunchConfiguration("data_root"), value_type=str)}
    identify = Node(
        package="piezo_client", executable="stage", output="screen",
        arguments=["--namespace", namespace, "identify",
                   "--output", LaunchConfiguration("directory")])
    return LaunchDescription([
        DeclareLaunchArgument("directory", default_value="runs/identified",
                              description="Gets the recordings and model.json; under data_root."),
        IncludeLaunchDescription(PythonLaunchDescriptionSource(stage)),
        Node(package="piezo_identification", executable="identification", output="screen",
             namespace=namespace, parameters=[data_root, LaunchConfiguration("parameters")]),
        identify,
        RegisterEventHandler(OnProcessExit(
            target_action=identify, on_exit=[EmitEvent(event=Shutdown())])),
    ])
