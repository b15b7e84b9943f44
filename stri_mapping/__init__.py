# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Map a street's facades live from a moving vehicle with SICK line scanners alone.

One horizontal scanner gives the vehicle's motion through its spatio-temporal range image
(Ono & Ikeuchi), vertical scanners give the facades.  This package imports no ROS outside
`stri_mapping.nodes`.
"""

__version__ = '0.1.0'
