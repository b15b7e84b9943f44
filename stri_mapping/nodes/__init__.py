# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: thin skins over the numerical cores; the only modules that import ROS."""

from importlib.util import find_spec
import os
import sys

if find_spec('rclpy') is None:
    sys.exit('ROS 2 is not installed for this Python: source your ROS 2 Jazzy set-up, or run '
             '"pip install stri_mapping[ros]"')

# An installation from pip wheels has no set-up file to source; its resource index is here.
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
