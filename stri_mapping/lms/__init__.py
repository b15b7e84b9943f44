# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The SICK LMS 2xx line scanners (LMS200, 211, 220, 221, 291): codec, mirror clock and device.

Nothing here knows ROS, and only `port`, `capture` and `device` do any input or output.  Facts
about the protocol are from SICK's telegram listing (8007954/Q501, "TL" in comments) and from
what working drivers and logged telegrams show where it is wrong or silent.
"""
