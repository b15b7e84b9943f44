# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A recorded drive through the graph: player, estimator, aligner, RViz; over when it is over."""

from pathlib import Path

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from stri_mapping.bag_io import Bag, select_scanners
from stri_mapping.nodes.launch_parts import common_arguments, declared, over_with, part, typed
from stri_mapping.vehicle import load_vehicle


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments, the player, and include the rest."""
    common = common_arguments('replay', 'roles, mounts and topics')
    own = {
        'rate': ('1.0', 'speed over that of recording; 0.0 for as fast as the nodes take it'),
        'start': ('0.0', 'seconds of the bag to leave out at its beginning'),
        'loop': ('false', 'whether to begin again at the end'),
    }
    return LaunchDescription([
        DeclareLaunchArgument('bag', description='rosbag2 directory, .mcap or ROS 1 .bag file'),
        *declared({**own, **common}), part('processing', common, rviz_sim_time='true'),
        OpaqueFunction(function=_player)])


def _player(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the player, which waits for as many readers as the bag's scanners will have."""
    value = {name: LaunchConfiguration(name).perform(context)
             for name in ('bag', 'vehicle_file', 'record')}
    with Bag(Path(value['bag'])) as bag:
        vehicle = select_scanners(bag, load_vehicle(Path(value['vehicle_file'])))
    readers = [s.topic for s in vehicle.scanners] * (2 if value['record'] else 1)
    player = Node(package='stri_mapping', executable='bag_player', name='bag_player',
                  output='screen', parameters=[
                      LaunchConfiguration('params_file'),
                      {'bag': value['bag'], 'subscribers': ' '.join(readers),
                       **typed({'rate': float, 'start': float, 'loop': bool})}])
    return [player, over_with(player, 'the bag is over')]
