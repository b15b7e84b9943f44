# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The graph on the vehicle: a driver for each scanner, estimator, aligner, recorder, RViz."""

from launch import LaunchDescription

from stri_mapping.nodes.launch_parts import common_arguments, declared, part


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and include the parts."""
    arguments = common_arguments('bringup', 'roles, mounts and ports')
    return LaunchDescription([
        *declared(arguments), part('processing', arguments), part('drivers', arguments)])
