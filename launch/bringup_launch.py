# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The graph on the vehicle: a driver for each scanner, estimator, aligner, recorder, RViz."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and include the parts."""
    share = FindPackageShare('stri_mapping')
    arguments = {
        'vehicle_file': (PathJoinSubstitution([share, 'config', 'vehicle.yaml']),
                         'scanners: their roles, mounts and ports'),
        'params_file': (PathJoinSubstitution([share, 'config', 'bringup.yaml']),
                        'parameters of the nodes'),
        'output': ('', 'folder for the results; empty for none'),
        'record': ('', 'bag to record; empty for none'),
        'rviz': ('false', 'whether to show the graph in RViz'),
        'use_sim_time': ('false', 'whether to take the time from /clock'),
    }
    parts = [IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([share, 'launch', f'{part}.launch.py'])),
        launch_arguments={name: LaunchConfiguration(name) for name in arguments}.items())
        for part in ('processing', 'drivers')]
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, (default, text) in arguments.items()), *parts])
