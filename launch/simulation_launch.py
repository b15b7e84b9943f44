# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A virtual drive: its scanners at pseudo-terminals, and the same nodes as on the vehicle."""

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from stri_mapping.nodes.launch_parts import common_arguments, declared, over_with, part, typed


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments, the virtual vehicle, and include the rest."""
    arguments = {
        'scene': ('street', 'the street: "stri-mapping simulate list" names them all'),
        'seed': ('1', 'draws everything random'),
        'duration': ('0.0', "seconds of the drive; 0.0 for the scene's own"),
        'ports': ('/tmp/stri_mapping_ports', "folder for the scanners' ports"),
        **common_arguments('simulation', 'roles and mounts'),
    }
    return LaunchDescription([
        *declared(arguments), part('processing', arguments), part('drivers', arguments),
        OpaqueFunction(function=_vehicle)])


def _vehicle(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the vehicle, which waits for the readers: the first time, they compile for long."""
    readers = 2 if LaunchConfiguration('record').perform(context) else 1
    values = typed({
        'scene': str, 'seed': int, 'duration': float, 'ports': str, 'vehicle_file': str})
    vehicle = Node(package='stri_mapping', executable='virtual_vehicle', name='virtual_vehicle',
                   output='screen', parameters=[
                       LaunchConfiguration('params_file'), {'readers': readers, **values}])
    return [vehicle, over_with(vehicle, 'the drive is over')]
