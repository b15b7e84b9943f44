# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
A path that goes on after its estimator died: where it left off, and where the new one begins.

REP-105 asks of odom that it never jumps.  What happened meanwhile nobody has seen; the vehicle
is taken to have kept its last velocity.  The time without poses stays a gap in the results.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stri_mapping import geometry
from stri_mapping.motion_file import cut_to_common, read_velocity
from stri_mapping.results import TRAJECTORY_NAME, VELOCITY_NAME
from stri_mapping.stri.estimate import Estimate
from stri_mapping.trajectory import read_tum

Array = NDArray[np.float64]
# Seconds for which the last velocity is believed; a longer gap is one of a vehicle at rest.
COASTING = 10.0


@dataclass(frozen=True, eq=False)
class Interruption:
    """
    The end of the path that is on disk.

    Attributes
    ----------
    stamps_ns
        (n,) of all its poses.
    pose
        (3,) the last one: x, y, yaw of base_link in odom.
    twist
        (3,) the last one: vx, vy, wz of base_link in base_link.

    """

    stamps_ns: NDArray[np.int64]
    pose: Array
    twist: Array

    def pose_at(self, stamp_ns: int) -> Array:
        """Return where the vehicle is taken to be at a later time, (3,)."""
        seconds = (stamp_ns - int(self.stamps_ns[-1])) * 1e-9
        return geometry.compose(self.pose, geometry.exp(min(seconds, COASTING) * self.twist))


def interruption(folder: Path) -> Interruption | None:
    """
    Return where the path in a results folder ends; None where there is none.

    Files that the crash left with half a line, or one longer than the other, are cut to what
    they have in common.

    Raises
    ------
    StriMappingError
        If they are not what this package writes.

    """
    trajectory, velocity = folder / TRAJECTORY_NAME, folder / VELOCITY_NAME
    if not (trajectory.is_file() and velocity.is_file()):
        return None
    if not cut_to_common(folder):
        return None
    path = read_tum(trajectory)
    _, values = read_velocity(velocity)
    return Interruption(path.stamps_ns, path.poses[-1], values[-1, :3])


def placed(estimate: Estimate, T_odom_start: Array) -> Estimate:
    """
    Return an estimate in odom when its own path began at a pose in odom.

    Parameters
    ----------
    estimate
        Relative to the beginning of its path.
    T_odom_start
        (3,) x, y, yaw of that beginning in odom.

    """
    turn = geometry.rotation_from_rpy(0.0, 0.0, T_odom_start[2])
    return replace(estimate, pose=geometry.compose(T_odom_start, estimate.pose),
                   pose_covariance=turn @ estimate.pose_covariance @ turn.T)
