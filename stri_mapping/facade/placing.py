# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Rays of many scan lines at once: into base_link, and from there into odom."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from stri_mapping import geometry
from stri_mapping.facade.angles import cos_sin, heading
from stri_mapping.facade.points import Rays
from stri_mapping.scan import Scan
from stri_mapping.trajectory import constant_speed, Trajectory

Array = NDArray[np.float64]

# Ranges beyond this are not finite, metres.
FAR = 1e9


def rays_of(scans: Sequence[Scan], rings: Sequence[int], T_base_laser: Array, path: Trajectory,
            max_gap: float) -> tuple[Rays, int, int]:
    """
    Return the rays of some scan lines that hit something at a time with a pose.

    Parameters
    ----------
    scans, rings
        The lines, and the scanner of each.
    T_base_laser
        (r, 4, 4) the scanners' mounts.
    path
        Poses, interpolated at each ray's time as `Trajectory.at` does.
    max_gap
        Longest time between two poses, in seconds, that is bridged.

    Returns
    -------
    rays : Rays
        In the order of the lines.
    no_return, outside : int
        Rays left out because nothing came back, and because there was no pose.

    """
    limits = np.array([(scan.range_min, min(scan.range_max, FAR)) for scan in scans])
    begin = np.concatenate([[0], np.cumsum([len(scan) for scan in scans])])
    stamps = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    ring = np.array(rings, dtype=np.uint16)
    ranges, angles, seconds = (np.concatenate([getattr(scan, name) for scan in scans])
                               for name in ('ranges', 'angles', 'times'))
    base, poses, times, intensity, first, no_return = _rays_of(
        ranges, angles, seconds, _intensity(scans), begin, stamps, ring, limits, T_base_laser,
        path.stamps_ns, path.poses, int(max_gap * 1e9))
    return (Rays(base, poses, times, intensity, np.repeat(ring, np.diff(first)), first),
            no_return, len(ranges) - len(base) - no_return)


def place(base: Array, poses: Array, attitude: Array, pivot: Array) -> Array:
    """
    Return points of base_link in odom, each by its own pose.

    Parameters
    ----------
    base
        (n, 3) metres in base_link.
    poses
        (n, 3) planar poses x, y, yaw: metres, metres, radians.
    attitude
        (n, 3) roll and pitch in radians, heave in metres.
    pivot
        (3,) the point of base_link whose way the planar poses tell, metres: what measured
        them.  The body rolls and pitches about it as far as x and y go.

    Returns
    -------
    Array
        (n, 3) ``T_odom_base p`` with ``T_odom_base = Rz(yaw) [Ry(pitch) Rx(roll) | s]``, where
        s has the heave and the horizontal part of ``c - Ry Rx c`` for the pivot c.

    """
    return np.asarray(_place(base, poses, attitude, pivot))


def full_poses(poses: Array, attitude: Array, pivot: Array) -> Array:
    """Return T_odom_base as (n, 6) x, y, z, roll, pitch, yaw; parameters as for `place`."""
    origin = place(np.zeros((len(poses), 3)), poses, attitude, pivot)
    return np.column_stack([origin, attitude[:, :2], poses[:, 2]])


@numba.njit(cache=True)
def _rays_of(  # type: ignore[no-untyped-def]
    ranges, angles, times, given, begin, stamps, ring, limits, T, pose_stamps, poses, max_gap,
):
    base, at = np.empty((len(ranges), 3)), np.empty((len(ranges), 3))
    intensity = np.empty(len(ranges), np.float32)
    when, first = np.empty(len(ranges), np.int64), np.zeros(len(stamps) + 1, np.int64)
    n, no_return, k, step = 0, 0, 0, np.zeros(3)
    start, stop = 1, 0                           # the interval of poses k, none yet
    longest = 1
    for i in range(len(stamps)):
        longest = max(longest, begin[i + 1] - begin[i])
    # a scanner's rays keep their angles from scan to scan: known, cosine and sine of each
    known = np.full((len(T), longest, 3), np.nan)
    for i in range(len(stamps)):
        mount, rays, nearest, furthest = T[ring[i]], known[ring[i]], limits[i, 0], limits[i, 1]
        for j in range(begin[i], begin[i + 1]):
            if not nearest <= ranges[j] <= furthest:
                no_return += 1
                continue
            t = stamps[i] + int(np.rint(times[j] * 1e9))
            if not start <= t < stop:
                k = _interval(pose_stamps, t, max(k, 0))
                if k < 0:
                    start, stop = 1, 0
                    continue
                start, stop = pose_stamps[k], pose_stamps[k + 1]
                _log_step(poses[k], poses[k + 1], step)
            if stop - start > max_gap and t != start and t != stop:
                continue
            at[n, 0], at[n, 1], at[n, 2] = _along(poses, k, step, (t - start) / (stop - start))
            q = j - begin[i]
            if rays[q, 0] != angles[j]:
                rays[q, 0], rays[q, 1] = angles[j], math.cos(angles[j])
                rays[q, 2] = math.sin(angles[j])
            x, y = ranges[j] * rays[q, 1], ranges[j] * rays[q, 2]
            for m in range(3):
                base[n, m] = x * mount[m, 0] + y * mount[m, 1] + mount[m, 3]
            when[n], intensity[n] = t, 0.0 if math.isnan(given[j]) else given[j]
            n += 1
        first[i + 1] = n
    return base[:n], at[:n], when[:n], intensity[:n], first, no_return


@numba.njit(cache=True, inline='always')
def _interval(stamps, t, k):  # type: ignore[no-untyped-def]
    """Return the interval between two stamps that holds t, looking from k on; -1 for none."""
    if len(stamps) < 2 or t < stamps[0] or t > stamps[-1]:
        return -1
    while k > 0 and stamps[k] > t:
        k -= 1
    if stamps[k] > t or k + 64 < len(stamps) and stamps[k + 64] <= t:
        k = np.searchsorted(stamps, t, side='right') - 1
    while k < len(stamps) - 2 and stamps[k + 1] <= t:
        k += 1
    return min(k, len(stamps) - 2)


@numba.njit(cache=True, inline='always')
def _log_step(a, b, step):  # type: ignore[no-untyped-def]
    """Write the step from pose a to pose b: `geometry.log`, turned into odom."""
    c, s, yaw = math.cos(a[2]), math.sin(a[2]), b[2] - a[2]
    x = c * (b[0] - a[0]) + s * (b[1] - a[1])
    y = c * (b[1] - a[1]) - s * (b[0] - a[0])
    half = 0.5 * yaw
    scale = math.sin(half) / half if abs(half) > 1e-8 else 1.0
    c, s = math.cos(half) / scale, math.sin(half) / scale
    x, y = c * x + s * y, c * y - s * x
    c, s = math.cos(a[2]), math.sin(a[2])
    step[0], step[1], step[2] = c * x - s * y, s * x + c * y, yaw


@numba.njit(cache=True, inline='always')
def _along(poses, k, step, fraction):  # type: ignore[no-untyped-def]
    """Return the pose at a fraction of a step from pose k: `geometry.exp` composed with it."""
    half = 0.5 * fraction * step[2]
    c, s = cos_sin(half)
    scale = fraction * (s / half if abs(half) > 1e-8 else 1.0)
    c, s = scale * c, scale * s
    return (poses[k, 0] + c * step[0] - s * step[1], poses[k, 1] + s * step[0] + c * step[1],
            poses[k, 2] + fraction * step[2])


@numba.njit(cache=True)
def _place(base, poses, attitude, pivot):  # type: ignore[no-untyped-def]
    out, known = np.empty((len(base), 3)), np.full(3, np.nan)
    for i in range(len(base)):
        cr, sr = cos_sin(attitude[i, 0])
        cp, sp = cos_sin(attitude[i, 1])
        cy, sy = heading(poses[i, 2], known)
        x, y, z = base[i, 0] - pivot[0], base[i, 1] - pivot[1], base[i, 2] - pivot[2]
        ahead = cp * x + sp * (sr * y + cr * z) + pivot[0]
        left = cr * y - sr * z + pivot[1]
        out[i, 0] = poses[i, 0] + cy * ahead - sy * left
        out[i, 1] = poses[i, 1] + sy * ahead + cy * left
        out[i, 2] = attitude[i, 2] - sp * base[i, 0] + cp * (sr * base[i, 1] + cr * base[i, 2])
    return out


def _intensity(scans: Sequence[Scan]) -> Array:
    """Return the intensity of every ray; 0 where the scanner gives none."""
    return np.concatenate([np.zeros(len(s)) if s.intensities is None else s.intensities
                           for s in scans], dtype=np.float64)


def at_constant_speed(xyz: Array, stamps_ns: ArrayLike, trajectory: Trajectory) -> Array:
    """
    Return the points as they would lie had the vehicle driven straight at its mean speed.

    This is the facade before alignment, as the paper shows it (figures 12 and 13), made from the
    finished cloud alone: p_before = T_mean(t) T(t)^-1 p.

    Parameters
    ----------
    xyz
        (n, 3) points in odom, metres.
    stamps_ns
        (n,) times of their rays, nanoseconds.
    trajectory
        The poses the points were placed with.

    Returns
    -------
    Array
        (n, 3); NaN where the trajectory has no pose.

    """
    planar = np.column_stack([xyz[:, :2], np.zeros(len(xyz))])
    base = geometry.compose(geometry.inverse(trajectory.at(stamps_ns)), planar)
    moved = geometry.compose(constant_speed(trajectory).at(stamps_ns), base)
    return np.column_stack([moved[:, :2], xyz[:, 2] + 0.0 * moved[:, 0]])
