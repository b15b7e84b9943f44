# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: thin skins over the numerical cores; the only modules that import ROS."""

from importlib.util import find_spec
import os
import sys

from stri_mapping.vehicle import shared_file

if find_spec('rclpy') is None:
    sys.exit('ROS 2 is not installed for this Python: source your ROS 2 Jazzy set-up, or run '
             '"pip install stri_mapping[ros]"')

# An installation from pip wheels has no set-up file to source; its resource index is here.
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
# Nodes find one another within half a second, also one that was restarted.
if not any(f'{name}_DEFAULT_PROFILES_FILE' in os.environ for name in ('FASTRTPS', 'FASTDDS')):
    os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(shared_file('config/fastdds.xml'))
