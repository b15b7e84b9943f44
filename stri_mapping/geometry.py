# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Rigid motions in the plane, SE(2), and in space, SE(3).

`T_a_b` reads "a from b": it takes coordinates in frame b to coordinates in frame a, so products
chain, ``T_a_c = T_a_b @ T_b_c``.  A planar pose is the triple ``(x, y, yaw)`` in metres and
radians, a spatial one a 4x4 matrix.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def wrap_angle(angle: ArrayLike) -> Array:
    """Return angles wrapped to [-pi, pi); any shape, radians, NaN stays NaN."""
    return np.asarray((np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi)


def compose(a: ArrayLike, b: ArrayLike) -> Array:
    """
    Return the planar product a * b.

    Parameters
    ----------
    a, b
        Poses (..., 3) as (x, y, yaw); shapes broadcast.

    Returns
    -------
    Array
        Poses (..., 3).  The yaw is the plain sum, not wrapped, so that turns accumulate.

    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + cos * b[..., 0] - sin * b[..., 1]
    y = a[..., 1] + sin * b[..., 0] + cos * b[..., 1]
    return np.stack([x, y, a[..., 2] + b[..., 2]], axis=-1)


def inverse(pose: ArrayLike) -> Array:
    """Return the inverse of planar poses (..., 3), so that ``compose(inverse(p), p) == 0``."""
    pose = np.asarray(pose, dtype=float)
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x = -cos * pose[..., 0] - sin * pose[..., 1]
    y = sin * pose[..., 0] - cos * pose[..., 1]
    return np.stack([x, y, -pose[..., 2]], axis=-1)


def exp(twist: ArrayLike) -> Array:
    """
    Return the planar pose reached by a constant body twist after unit time.

    Parameters
    ----------
    twist
        (..., 3) as (vx, vy, wz) times the duration: metres, metres, radians.

    Returns
    -------
    Array
        Poses (..., 3): the exponential map of SE(2), exact through zero rotation.

    """
    twist = np.asarray(twist, dtype=float)
    half = 0.5 * twist[..., 2]
    # chord = arc * sin(half) / half, turned by half: free of cancellation at small rotation
    scale = np.sinc(half / np.pi)
    cos, sin = scale * np.cos(half), scale * np.sin(half)
    x = cos * twist[..., 0] - sin * twist[..., 1]
    y = sin * twist[..., 0] + cos * twist[..., 1]
    return np.stack([x, y, twist[..., 2]], axis=-1)


def log(pose: ArrayLike) -> Array:
    """Return the body twist (..., 3) whose `exp` is the pose; undoes `exp` for |yaw| < 2 pi."""
    pose = np.asarray(pose, dtype=float)
    half = 0.5 * pose[..., 2]
    scale = np.sinc(half / np.pi)
    cos, sin = np.cos(half) / scale, np.sin(half) / scale
    x = cos * pose[..., 0] + sin * pose[..., 1]
    y = -sin * pose[..., 0] + cos * pose[..., 1]
    return np.stack([x, y, pose[..., 2]], axis=-1)


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Return the 3x3 rotation of fixed-axis roll, pitch, yaw in radians (REP-103)."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])


def rpy_from_rotation(rotation: ArrayLike) -> Array:
    """Return fixed-axis (roll, pitch, yaw) in radians of a 3x3 rotation; pitch in +-pi/2."""
    r = np.asarray(rotation, dtype=float)
    cos_pitch = np.hypot(r[0, 0], r[1, 0])
    pitch = np.arctan2(-r[2, 0], cos_pitch)
    if cos_pitch < 1e-8:        # x straight up or down: roll and yaw turn the same way, yaw is 0
        return np.array([np.arctan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def transform(xyz: ArrayLike, rpy: ArrayLike) -> Array:
    """Return the 4x4 transform of a translation in metres and fixed-axis angles in radians."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_rpy(*np.asarray(rpy, dtype=float))
    matrix[:3, 3] = xyz
    return matrix


def planar_pose(matrix: ArrayLike) -> Array:
    """Return a 4x4 pose seen from above as (x, y, yaw), the yaw that of its x axis."""
    m = np.asarray(matrix, dtype=float)
    return np.array([m[0, 3], m[1, 3], np.arctan2(m[1, 0], m[0, 0])])


def rotation_from_quat(quat_xyzw: ArrayLike) -> Array:
    """
    Return the 3x3 rotation of a quaternion (x, y, z, w), normalised first.

    Raises
    ------
    ValueError
        If the quaternion is not finite or shorter than 1e-6.

    """
    q = np.asarray(quat_xyzw, dtype=float)
    norm = float(np.linalg.norm(q))
    if not np.isfinite(norm) or norm < 1e-6:
        raise ValueError(f'quaternion {q.tolist()} has no direction')
    x, y, z, w = q / norm
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def quat_from_rotation(rotation: ArrayLike) -> Array:
    """Return the quaternion (x, y, z, w), w >= 0, of a 3x3 rotation."""
    r = np.asarray(rotation, dtype=float)
    # the largest of the four is found first, so that nothing is divided by a small number
    squares = np.array([1.0 + r[0, 0] - r[1, 1] - r[2, 2], 1.0 - r[0, 0] + r[1, 1] - r[2, 2],
                        1.0 - r[0, 0] - r[1, 1] + r[2, 2], 1.0 + np.trace(r)])
    products = np.array([
        [squares[0], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
        [r[0, 1] + r[1, 0], squares[1], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
        [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], squares[2], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]]])
    quat = products[np.argmax(squares)]
    return np.asarray(quat / np.linalg.norm(quat) * (1.0 if quat[3] >= 0.0 else -1.0))


def quat_from_rpy(rpy: ArrayLike) -> Array:
    """Return quaternions (..., 4) as (x, y, z, w), w >= 0, of angles (..., 3), see `transform`."""
    half = 0.5 * np.asarray(rpy, dtype=float)
    (sr, sp, sy), (cr, cp, cy) = (np.moveaxis(f(half), -1, 0) for f in (np.sin, np.cos))
    quat = np.stack([sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
                     cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy], axis=-1)
    return np.where(quat[..., 3:] < 0.0, -quat, quat)


def quat_from_yaw(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of a rotation about z by yaw in radians."""
    return 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def yaw_from_quat(quat_xyzw: ArrayLike) -> Array:
    """Return the heading (...,) in radians of quaternions (..., 4) as (x, y, z, w)."""
    x, y, z, w = np.moveaxis(np.asarray(quat_xyzw, dtype=float), -1, 0)
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
