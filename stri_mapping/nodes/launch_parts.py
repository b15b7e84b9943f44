# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the launch files have in common; needs ROS 2's launch and launch_ros."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.some_substitutions_type import SomeSubstitutionsType
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

# By name: default and description.
Arguments = Mapping[str, tuple[SomeSubstitutionsType, str]]
SHARE = FindPackageShare('stri_mapping')


def common_arguments(use: str, scanners: str) -> Arguments:
    """
    Return the arguments that every launch file has.

    Parameters
    ----------
    use
        Stem of the launch file and of its file of parameters.
    scanners
        What of the scanners the vehicle file is read for.

    """
    return {
        'vehicle_file': (PathJoinSubstitution([SHARE, 'config', 'vehicle.yaml']),
                         f'scanners: their {scanners}'),
        'params_file': (PathJoinSubstitution([SHARE, 'config', f'{use}.yaml']),
                        'parameters of the nodes'),
        'output': ('', 'folder for the results; empty for none'),
        'record': ('', 'bag to record; empty for none'),
        'rviz': ('false', 'whether to show the graph in RViz'),
        'use_sim_time': ('false', 'whether the nodes take the time from /clock'),
    }


def declared(arguments: Arguments) -> list[DeclareLaunchArgument]:
    """Return the declarations of arguments."""
    return [DeclareLaunchArgument(name, default_value=default, description=text)
            for name, (default, text) in arguments.items()]


def part(name: str, arguments: Iterable[str], **fixed: str) -> IncludeLaunchDescription:
    """Return a part of the graph that is given some of this launch file's arguments."""
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution(
            [SHARE, 'launch', f'{name}.launch.py'])),
        launch_arguments=[*((each, LaunchConfiguration(each)) for each in arguments),
                          *fixed.items()])


def typed(kinds: Mapping[str, type]) -> dict[str, ParameterValue]:
    """Return arguments as parameters of their types."""
    return {name: ParameterValue(LaunchConfiguration(name), value_type=kind)
            for name, kind in kinds.items()}


def over_with(node: Node, reason: str) -> RegisterEventHandler:
    """Return what ends everything when a node has ended."""
    return RegisterEventHandler(OnProcessExit(
        target_action=node, on_exit=[Shutdown(reason=reason)]))
