# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Streets that are not level: the level street sheared upwards.

z grows by grade . (x, y).  What is upright stays upright, as builders do, and the ground slopes.
A shear keeps straight lines straight: rays towards movers, which know level streets alone, are
sheared back instead.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from stri_mapping.simulation.mesh import Mesh
from stri_mapping.simulation.motion import KNOT, Motion

Array = NDArray[np.float64]


def sloped_mesh(mesh: Mesh, grade: ArrayLike) -> Mesh:
    """Return a mesh on a slope of `grade` (2,), rise per metre along x and y."""
    triangles = mesh.triangles.copy()
    triangles[..., 2] += triangles[..., :2] @ np.asarray(grade)
    return replace(mesh, triangles=triangles)


def sloped_motion(motion: Motion, grade: ArrayLike) -> Motion:
    """
    Return a motion on a slope: the vehicle stands square on the ground as it does on level ground.

    x, y and yaw stay; roll and pitch are those of the slope with the body's own on top.
    """
    poses = motion.at(np.arange(round(motion.duration / KNOT) + 1) * KNOT)
    rise, yaw = np.asarray(grade, dtype=float), poses[:, 5]
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    ahead = np.column_stack([ahead, ahead @ rise])
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    up = np.array([-rise[0], -rise[1], 1.0]) / np.sqrt(1.0 + rise @ rise)
    ground = np.stack([ahead, np.cross(up, ahead), np.broadcast_to(up, ahead.shape)], axis=2)
    body = Rotation.from_euler('xyz', poses[:, 3:5] @ np.eye(2, 3))
    attitude = (Rotation.from_matrix(ground) * body).as_euler('xyz')
    height = poses[:, 2] + poses[:, :2] @ rise
    return Motion(np.column_stack([poses[:, :2], height, attitude[:, :2],
                                   np.unwrap(attitude[:, 2])]))


def levelled(origins: Array, directions: Array, grade: Array) -> tuple[Array, Array, Array]:
    """
    Return rays on a slope as they run over the level street.

    Returns
    -------
    origins, directions : Array
        (n, 3), directions of unit length.
    stretch : Array
        (n,) length on the level street of a metre of each ray.

    """
    origins, directions = origins.copy(), directions.copy()
    origins[:, 2] -= origins[:, :2] @ grade
    directions[:, 2] -= directions[:, :2] @ grade
    stretch = np.linalg.norm(directions, axis=1)
    return origins, directions / stretch[:, None], stretch
