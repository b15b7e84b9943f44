# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Part of the other launch files: estimator, aligner, recorder and RViz."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

# Seconds that a node may take to write its results when stopped, and to die when told to.
PATIENCE = {'sigterm_timeout': '120', 'sigkill_timeout': '10'}


def generate_launch_description() -> LaunchDescription:
    """Describe the nodes that follow the scans."""
    share = FindPackageShare('stri_mapping')
    sim_time = {'use_sim_time': ParameterValue(
        LaunchConfiguration('use_sim_time'), value_type=bool)}
    common = {'vehicle_file': ParameterValue(LaunchConfiguration('vehicle_file'), value_type=str),
              'output': ParameterValue(LaunchConfiguration('output'), value_type=str), **sim_time}
    record = {'path': ParameterValue(LaunchConfiguration('record'), value_type=str), **sim_time}
    params = LaunchConfiguration('params_file')
    nodes = [Node(package='stri_mapping', executable=name, name=name, output='screen',
                  parameters=[params, common], **PATIENCE)
             for name in ('stri_estimator', 'facade_aligner')]
    recorder = Node(package='stri_mapping', executable='bag_recorder', name='bag_recorder',
                    output='screen', parameters=[params, record], **PATIENCE,
                    condition=IfCondition(
                        NotEqualsSubstitution(LaunchConfiguration('record'), '')))
    rviz = Node(package='rviz2', executable='rviz2', name='rviz2', output='screen',
                arguments=['-d', PathJoinSubstitution([share, 'config', 'stri_mapping.rviz'])],
                parameters=[{'use_sim_time': ParameterValue(
                    LaunchConfiguration('rviz_sim_time'), value_type=bool)}],
                condition=IfCondition(LaunchConfiguration('rviz')))
    names = {'vehicle_file': 'scanners: their roles, mounts and ports',
             'params_file': 'parameters of the nodes', 'output': 'folder for the results',
             'record': 'bag to record; empty for none', 'rviz': 'whether to show RViz',
             'use_sim_time': 'whether to take the time from /clock'}
    return LaunchDescription([
        *(DeclareLaunchArgument(name, description=text) for name, text in names.items()),
        DeclareLaunchArgument('rviz_sim_time', default_value=LaunchConfiguration('use_sim_time'),
                              description='whether RViz takes the time from /clock'),
        *nodes, recorder, rviz])
