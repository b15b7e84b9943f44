# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Part of the other launch files: one driver for each scanner, configured, then activated."""

from pathlib import Path

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
    TimerAction,
)
from launch.event_handlers import OnProcessStart
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

from stri_mapping.vehicle import load_vehicle, Scanner

# Seconds between two attempts to configure a driver.
RETRY = 2.0


def generate_launch_description() -> LaunchDescription:
    """Describe the drivers once it is known which scanners the vehicle has."""
    return LaunchDescription([
        DeclareLaunchArgument('vehicle_file', description='scanners: their ports and frames'),
        DeclareLaunchArgument('params_file', description='parameters of the drivers'),
        DeclareLaunchArgument('ports', default_value='',
                              description='folder with a port for each scanner, by its name; '
                              'empty for those of the vehicle file'),
        OpaqueFunction(function=_drivers)])


def _drivers(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    value = {name: LaunchConfiguration(name).perform(context)
             for name in ('vehicle_file', 'params_file', 'ports')}
    vehicle = load_vehicle(Path(value['vehicle_file']))
    return [action for scanner in vehicle.scanners
            for action in _driver(scanner, value['params_file'], value['ports'])]


def _driver(scanner: Scanner, params_file: str, ports: str) -> list[LaunchDescriptionEntity]:
    """Return a driver and the events that take it from state to state."""
    port = dict(scanner.port)
    if ports:
        port['serial_port'] = f'{ports}/{scanner.name}'
    driver = LifecycleNode(
        package='stri_mapping', executable='sick_lms_driver', name='sick_lms_driver',
        namespace=scanner.name, output='screen', sigterm_timeout='15',
        parameters=[params_file, {'frame_id': scanner.frame, **port}],
        remappings=[('scan', '/' + scanner.topic.lstrip('/'))])

    def change(transition: int) -> EmitEvent:
        return EmitEvent(event=ChangeState(lifecycle_node_matcher=matches_action(driver),
                                           transition_id=transition))

    return [
        RegisterEventHandler(OnProcessStart(
            target_action=driver, on_start=[change(Transition.TRANSITION_CONFIGURE)])),
        RegisterEventHandler(OnStateTransition(
            target_lifecycle_node=driver, start_state='configuring', goal_state='inactive',
            entities=[change(Transition.TRANSITION_ACTIVATE)])),
        # no scanner there yet, or none that answers
        RegisterEventHandler(OnStateTransition(
            target_lifecycle_node=driver, start_state='configuring', goal_state='unconfigured',
            entities=[TimerAction(
                period=RETRY, actions=[change(Transition.TRANSITION_CONFIGURE)])])),
        driver]
