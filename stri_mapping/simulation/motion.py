# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""How the vehicle moves: a path, a speed along it, and the body on its springs, over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

# Interval of the knots that define a motion, seconds: ten times finer than anything a car does.
KNOT = 0.01
# Interval of the knots that define a path, metres.
PATH_STEP = 0.05


class Motion:
    """
    Pose of base_link in odom as a smooth function of time.

    The poses at the knots are joined by a cubic spline in each of x, y, z, roll, pitch, yaw, and
    that spline is the truth: positions, velocities and ray times all agree exactly.

    Attributes
    ----------
    duration
        Seconds for which the motion is defined, from 0.

    """

    def __init__(self, poses: Array) -> None:
        """Take poses (n, 6) at multiples of `KNOT`: x, y, z in metres, roll, pitch, yaw."""
        self.duration = (len(poses) - 1) * KNOT
        self._spline = CubicSpline(np.arange(len(poses)) * KNOT, poses)
        self._rate = self._spline.derivative()

    def at(self, times: ArrayLike) -> Array:
        """Return poses (n, 6) at times (n,) in seconds; x, y, z, roll, pitch, yaw."""
        return np.asarray(self._spline(np.asarray(times, dtype=float)))

    def twist(self, times: ArrayLike) -> Array:
        """
        Return the velocity of base_link in base_link at times (n,) in seconds.

        Returns
        -------
        Array
            (n, 6): linear in m/s, angular in rad/s.

        """
        rate = np.asarray(self._rate(np.asarray(times, dtype=float)))
        _, _, _, roll, pitch, yaw = self.at(times).T
        sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
        sy, cy = np.sin(yaw), np.cos(yaw)
        vx, vy, vz, droll, dpitch, dyaw = rate.T
        # R^T v and the body rates of fixed-axis roll, pitch, yaw
        return np.stack([
            cy * cp * vx + sy * cp * vy - sp * vz,
            (cy * sp * sr - sy * cr) * vx + (sy * sp * sr + cy * cr) * vy + cp * sr * vz,
            (cy * sp * cr + sy * sr) * vx + (sy * sp * cr - cy * sr) * vy + cp * cr * vz,
            droll - sp * dyaw,
            cr * dpitch + cp * sr * dyaw,
            -sr * dpitch + cp * cr * dyaw,
        ], axis=-1)


class Path:
    """
    A line in the plane by arc length, its curvature without jumps.

    Attributes
    ----------
    length
        Metres.

    """

    def __init__(self, pieces: Sequence[tuple[float, float]],
                 start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """
        Build a path from pieces (length in metres, turn in radians).

        Within a piece that turns the curvature swells and fades as a raised cosine, so that the
        steering wheel never has to jump; `start` is the pose (x, y, yaw) at arc length 0.
        """
        ends = np.concatenate([[0.0], np.cumsum([length for length, _ in pieces])])
        self.length = float(ends[-1])
        s = np.linspace(0.0, self.length, max(4, round(self.length / PATH_STEP)) + 1)
        yaw = np.full(len(s), start[2])
        for (length, turn), begin in zip(pieces, ends):
            u = np.clip((s - begin) / length, 0.0, 1.0)
            yaw += turn * (u - np.sin(2.0 * np.pi * u) / (2.0 * np.pi))
        heading = CubicSpline(s, np.column_stack([np.cos(yaw), np.sin(yaw)])).antiderivative()
        self._spline = CubicSpline(s, np.column_stack([heading(s) + start[:2], yaw]))

    def at(self, s: ArrayLike) -> Array:
        """Return poses (n, 3) as x, y, yaw at arc lengths (n,); straight on beyond the ends."""
        s = np.asarray(s, dtype=float)
        inside = np.clip(s, 0.0, self.length)
        pose = np.asarray(self._spline(inside))
        beyond = s - inside
        pose[:, 0] += beyond * np.cos(pose[:, 2])
        pose[:, 1] += beyond * np.sin(pose[:, 2])
        return pose


def lane_change(length: float, offset: float) -> list[tuple[float, float]]:
    """Return the two pieces of a `Path` that move it sideways by about `offset` metres."""
    turn = 2.0 * offset / length
    return [(0.5 * length, turn), (0.5 * length, -turn)]


def times(duration: float) -> Array:
    """Return the knots' times for a motion of at least `duration` seconds, plus 0.1 s."""
    return np.asarray(np.arange(int(np.ceil((duration + 0.1) / KNOT)) + 1) * KNOT)


def distance_along(speed: Array) -> Array:
    """Return the distance (n,) travelled at the knots from the speed (n,) there, m/s, signed."""
    t = np.arange(len(speed)) * KNOT
    return np.asarray(CubicSpline(t, speed).antiderivative()(t))


# Ono & Ikeuchi, figure 10: position against frame 0..450, highest power first; its slope, which
# is all that is used here, runs from 10 to 30 km/h when 170 m are driven in 34 s.
PAPER_POSITION = (-5.3928e-14, 6.9055e-11, -3.2321e-8, 7.0372e-6, -7.9814e-4, 1.0692e-1,
                  1.2734e-1)
PAPER_FRAMES = 450.0


def paper_speed(t: Array, length: float, duration: float) -> Array:
    """Return the paper's own speed profile scaled to `length` metres in `duration` seconds."""
    position = np.poly1d(PAPER_POSITION)
    frame = np.clip(t / duration, 0.0, 1.0) * PAPER_FRAMES
    scale = length / (position(PAPER_FRAMES) - position(0.0))
    return np.asarray(scale * position.deriv()(frame) * PAPER_FRAMES / duration)


def random_speed(t: Array, rng: np.random.Generator, low: float, high: float,
                 period: float = 8.0) -> Array:
    """
    Return a smooth random speed between two limits in m/s, as in traffic that flows.

    A cubic spline through random values every `period` seconds, never past the limits.
    """
    knots = np.arange(0.0, t[-1] + 3.0 * period, period)
    value = CubicSpline(knots, rng.uniform(-1.1, 1.1, len(knots)))(t)
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * np.tanh(1.2 * value))


def speed_through(t: Array, points: Sequence[tuple[float, float]],
                  smoothing: float = 0.8) -> Array:
    """
    Return the speed that runs through points (time in s, speed in m/s) at steady accelerations.

    Corners of the speed are rounded over `smoothing` seconds, so that jerk stays bounded.
    """
    at, speed = np.array(points, dtype=float).T
    width = max(1, round(0.5 * smoothing / KNOT))
    padded = np.concatenate([np.full(2 * width, t[0]), t, np.full(2 * width, t[-1])])
    raw = np.interp(padded, at, speed)
    box = np.ones(width) / width
    smooth = np.convolve(np.convolve(raw, box, 'same'), box, 'same')
    return np.asarray(smooth[2 * width:-2 * width])
