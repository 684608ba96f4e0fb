# SPDX-License-Identifier: BSD-3-Clause
"""A stage and the recorder; the simulated stage unless another is named."""

from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description():
    """Describe what is started, and the arguments."""
    default = PathJoinSubstitution(
        [FindPackageShare("piezo_bringup"), "config", [LaunchConfiguration("profile"), ".yaml"]])
    data_root = {"data_root": ParameterValue(LaunchConfiguration("data_root"), value_type=str)}
    settings = {
        "namespace": LaunchConfiguration("namespace"),
        # What the parameter file says counts more.
        "parameters": [data_root, LaunchConfiguration("parameters")],
        "output": "screen",
    }
    return LaunchDescription([
        DeclareLaunchArgument("namespace", default_value="", description="Of all nodes."),
        DeclareLaunchArgument("profile", default_value="simulated_stage",
                              description="Parameters of this package: simulated_stage, "
                              "simulated_axes for two axes, or hardware for low limits."),
        DeclareLaunchArgument("parameters", default_value=default,
                              description="Parameter file (YAML), in place of the profile's."),
        DeclareLaunchArgument("data_root", default_value=".",
                              description="Folder under which the nodes read and write."),
        DeclareLaunchArgument(
            "discovery_range", default_value="LOCALHOST",
            description="LOCALHOST, or SUBNET to let other machines command the stage."),
        DeclareLaunchArgument("stage_package", default_value="piezo_sim",
                              description="Package of the stage's node."),
        DeclareLaunchArgument("stage_executable", default_value="stage_sim",
                              description="Executable of the stage's node."),
        SetEnvironmentVariable(
            "ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery_range")),
        Node(package=LaunchConfiguration("stage_package"),
             executable=LaunchConfiguration("stage_executable"), **settings),
        Node(package="piezo_recorder", executable="recorder", **settings),
    ])
