# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Estimator and aligner for scans that drivers publish, or `ros2 bag play` plays."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Describe both nodes with the parameters they share."""
    vehicle = PathJoinSubstitution([FindPackageShare('stri_mapping'), 'config', 'vehicle.yaml'])
    parameters = {
        'vehicle_file': ParameterValue(LaunchConfiguration('vehicle_file'), value_type=str),
        'output': ParameterValue(LaunchConfiguration('output'), value_type=str),
        'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool),
    }
    return LaunchDescription([
        DeclareLaunchArgument('vehicle_file', default_value=vehicle,
                              description='scanners, their roles and mounts'),
        DeclareLaunchArgument('output', default_value='',
                              description='folder for the results; empty for none'),
        DeclareLaunchArgument('use_sim_time', default_value='false',
                              description='take the time from /clock, as with a played bag'),
        *(Node(package='stri_mapping', executable=name, name=name, output='screen',
               parameters=[parameters]) for name in ('stri_estimator', 'facade_aligner')),
    ])
