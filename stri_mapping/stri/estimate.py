# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator says about one scan's moment, by base_link's lever on the scanner's path."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.spline import basis, slopes

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


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def of_base(
    knots: Array, h: float, t: float, covariance: Array, first: int, mount: Array, origin: Array,
    pose: Array, pose_covariance: Array, twist: Array, twist_covariance: Array,
) -> None:
    """
    Write pose and twist of base_link, and their covariances, from the scanner's spline.

    Parameters
    ----------
    knots, h
        The scanner's spline, see `spline`.
    t
        Seconds on its clock.
    covariance, first
        (3 n, 3 n) of the coefficients from `first` on; a time outside takes the nearest.
    mount
        (3,) planar pose of the scanner in base_link.
    origin
        (3,) pose of the spline's frame in odom.
    pose, pose_covariance, twist, twist_covariance
        (3,), (3, 3), (3,), (3, 3) written, see `Estimate`.

    """
    weights, rates, at, rate = np.empty(4), np.empty(4), np.zeros(3), np.zeros(3)
    k = int(math.floor(t / h))
    basis(t / h - k, weights)
    slopes(t / h - k, h, rates)
    for i in range(4):
        for d in range(3):
            at[d] += weights[i] * knots[k + i, d]
            rate[d] += rates[i] * knots[k + i, d]
    yaw = at[2] - mount[2]
    cos, sin = math.cos(yaw), math.sin(yaw)
    # arm from the scanner to base_link, in the spline's frame
    arm_x, arm_y = -cos * mount[0] + sin * mount[1], -sin * mount[0] - cos * mount[1]
    co, so = math.cos(origin[2]), math.sin(origin[2])
    x, y = at[0] + arm_x, at[1] + arm_y
    pose[0] = origin[0] + co * x - so * y
    pose[1] = origin[1] + so * x + co * y
    pose[2] = origin[2] + yaw
    # the scanner's velocity along base_link's axes; its lever arm does the rest
    vx, vy = cos * rate[0] + sin * rate[1], -sin * rate[0] + cos * rate[1]
    twist[0], twist[1], twist[2] = vx + mount[1] * rate[2], vy - mount[0] * rate[2], rate[2]

    kept = len(covariance) // 3
    if k < first or k > first + kept - 4:
        k = min(max(k, first), first + kept - 4)
        u = 0.0 if t < k * h else 1.0
        basis(u, weights)
        slopes(u, h, rates)
    J_pose, J_twist = np.zeros((3, 12)), np.zeros((3, 12))
    for i in range(4):
        w, r, c = weights[i], rates[i], 3 * i
        J_pose[0, c], J_pose[0, c + 1] = co * w, -so * w
        J_pose[1, c], J_pose[1, c + 1] = so * w, co * w
        J_pose[0, c + 2] = w * (-co * arm_y - so * arm_x)
        J_pose[1, c + 2] = w * (-so * arm_y + co * arm_x)
        J_pose[2, c + 2] = w
        J_twist[0, c], J_twist[0, c + 1] = cos * r, sin * r
        J_twist[1, c], J_twist[1, c + 1] = -sin * r, cos * r
        # an error of the heading turns the velocity that goes with it
        J_twist[0, c + 2] = w * vy + mount[1] * r
        J_twist[1, c + 2] = -w * vx - mount[0] * r
        J_twist[2, c + 2] = r
    c = 3 * (k - first)
    block = covariance[c:c + 12, c:c + 12].copy()
    pose_covariance[:] = J_pose @ block @ J_pose.T
    twist_covariance[:] = J_twist @ block @ J_twist.T


def speed_sigma(twist_covariance: Array) -> float:
    """Return the standard deviation in m/s of a twist's velocity where it is least certain."""
    a, b, o = twist_covariance[0, 0], twist_covariance[1, 1], twist_covariance[0, 1]
    return math.sqrt(max(0.5 * (a + b) + math.hypot(0.5 * (a - b), o), 0.0))
