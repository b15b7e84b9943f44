# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A recorded drive through the graph: player, estimator, aligner, RViz; over when it is over."""

from pathlib import Path

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from stri_mapping.bag_io import Bag, select_scanners
from stri_mapping.vehicle import load_vehicle


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments, the player, and include the rest."""
    share = FindPackageShare('stri_mapping')
    arguments = {
        'vehicle_file': (PathJoinSubstitution([share, 'config', 'vehicle.yaml']),
                         'scanners: their roles, mounts and topics'),
        'params_file': (PathJoinSubstitution([share, 'config', 'replay.yaml']),
                        'parameters of the nodes'),
        'output': ('', 'folder for the results; empty for none'),
        'record': ('', 'bag to record; empty for none'),
        'rviz': ('false', 'whether to show the graph in RViz'),
        'use_sim_time': ('false', 'whether the nodes take the time from /clock too; RViz does'),
    }
    own = {
        'rate': ('1.0', 'speed over that of recording; 0.0 for as fast as the nodes take it'),
        'start': ('0.0', 'seconds of the bag to leave out at its beginning'),
        'loop': ('false', 'whether to begin again at the end'),
    }
    processing = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution(
            [share, 'launch', 'processing.launch.py'])),
        launch_arguments={'rviz_sim_time': 'true', **{
            name: LaunchConfiguration(name) for name in arguments}}.items())
    return LaunchDescription([
        DeclareLaunchArgument('bag', description='rosbag2 directory, .mcap or ROS 1 .bag file'),
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, (default, text) in (own | arguments).items()),
        processing, OpaqueFunction(function=_player)])


def _player(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the player, which waits for as many readers as the bag's scanners will have."""
    value = {name: LaunchConfiguration(name).perform(context)
             for name in ('bag', 'vehicle_file', 'record')}
    with Bag(Path(value['bag'])) as bag:
        vehicle = select_scanners(bag, load_vehicle(Path(value['vehicle_file'])))
    readers = [s.topic for s in vehicle.scanners] * (2 if value['record'] else 1)
    given = {name: ParameterValue(LaunchConfiguration(name), value_type=kind)
             for name, kind in (('rate', float), ('start', float), ('loop', bool))}
    player = Node(package='stri_mapping', executable='bag_player', name='bag_player',
                  output='screen', parameters=[
                      LaunchConfiguration('params_file'),
                      {'bag': value['bag'], 'subscribers': ' '.join(readers), **given}])
    over = Shutdown(reason='the bag is over')
    return [player, RegisterEventHandler(OnProcessExit(target_action=player, on_exit=[over]))]
