# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A virtual drive: its scanners at pseudo-terminals, and the same nodes as on the vehicle."""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments, the virtual vehicle, and include the rest."""
    share = FindPackageShare('stri_mapping')
    arguments = {
        'vehicle_file': (PathJoinSubstitution([share, 'config', 'vehicle.yaml']),
                         'scanners: their roles and mounts'),
        'params_file': (PathJoinSubstitution([share, 'config', 'simulation.yaml']),
                        'parameters of the nodes'),
        'output': ('', 'folder for the results; empty for none'),
        'record': ('', 'bag to record; empty for none'),
        'rviz': ('false', 'whether to show the graph in RViz'),
        'use_sim_time': ('false', 'whether to take the time from /clock'),
        'ports': ('/tmp/stri_mapping_ports', "folder for the scanners' ports"),
    }
    own = {
        'scene': ('street', 'the street: "stri-mapping simulate list" names them all'),
        'seed': ('1', 'draws everything random'),
        'duration': ('0.0', "seconds of the drive; 0.0 for the scene's own"),
    }
    kinds = {'scene': str, 'seed': int, 'duration': float, 'ports': str, 'vehicle_file': str}
    values = {name: ParameterValue(LaunchConfiguration(name), value_type=kind)
              for name, kind in kinds.items()}
    vehicle = Node(package='stri_mapping', executable='virtual_vehicle', name='virtual_vehicle',
                   output='screen', parameters=[LaunchConfiguration('params_file'), values])
    parts = [IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([share, 'launch', f'{part}.launch.py'])),
        launch_arguments={name: LaunchConfiguration(name) for name in arguments}.items())
        for part in ('processing', 'drivers')]
    over = Shutdown(reason='the drive is over')
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, (default, text) in (own | arguments).items()),
        vehicle, *parts,
        RegisterEventHandler(OnProcessExit(target_action=vehicle, on_exit=[over]))])
