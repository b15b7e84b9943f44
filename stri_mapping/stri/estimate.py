# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator says about one scan's moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    Pose and motion of base_link at the stamp of one horizontal scan.

    Attributes
    ----------
    stamp_ns
        Stamp of the scan (its first ray), integer nanoseconds.
    pose
        (3,) x, y, yaw of base_link in odom: metres, metres, radians (yaw not wrapped).
    pose_covariance
        (3, 3) of `pose`, in the same order and units squared.
    twist
        (3,) vx, vy, wz of base_link in base_link: m/s, m/s, rad/s.
    twist_covariance
        (3, 3) of `twist`.
    quality
        0 to 1: the share of the motion that the scans tell, 0 when coasting.
    degenerate
        Whether some direction of motion was not observable, so that the estimate coasts in it.

    """

    stamp_ns: int
    pose: Array
    pose_covariance: Array
    twist: Array
    twist_covariance: Array
    quality: float
    degenerate: bool
