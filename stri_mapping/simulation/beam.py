# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A beam of finite width, and the one range a time-of-flight range finder makes of it.

A beam is a bundle of sub-rays.  Each returns light in proportion to reflectance times cosine of
incidence over distance squared; the receiver adds them up, each with the rising edge of the
laser's pulse, and stops its counter when the sum reaches a set fraction of the whole.  On one
surface met head-on that is its distance, by calibration.  Two things known of the LMS 2xx follow
without further rules: at grazing incidence the light of the footprint's near side stops the
counter, and a partly hit edge reads between the two surfaces, or up to about two rise lengths
beyond the nearer one where the farther is out of reach of the pulse.

What is estimated from ranges should not hang on this one receiver.  So there are two simpler ones:
one that reports the middle of its footprint, or its near side where that is deep, and one whose
rays have no width but at edges.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Standard deviation of the pulse's rising edge as a distance, 1 ns out and back, and the share of
# the light at which the counter stops.  With the outdoor types' 11.9 mrad they pull a wall that
# is met at 50 degrees, 8 m to the side, by 7 mm of range and one met at 70 degrees by 10 cm.
RISE = 0.15
TRIGGER = 0.20

ECHOES = ('pulse', 'near side', 'middle')
# The receiver of 'near side': depth of a footprint in metres from where to where its near side
# gets the upper hand, how far behind its nearest point that is, and the depth from which on there
# are two surfaces.
NEAR_FROM, NEAR_TO, NEAR_SHARE, APART = 0.12, 0.24, 0.2, 2.0
# And of 'middle': metres between the middle and the mean of a footprint on more than one surface.
UNEVEN = 0.1

# Where the sub-rays pierce the beam's cross-section, radius 1: its middle and six points around,
# which together have a uniform disc's second moments.
_RING = np.arange(6) * np.pi / 3.0 + np.pi / 6.0
PATTERN = np.sqrt(7.0 / 12.0) * np.array(
    [(0.0, 0.0), *zip(np.cos(_RING).tolist(), np.sin(_RING).tolist())])
SUB_RAYS = len(PATTERN)


def sub_rays(poses: Array, angles: Array, T_base_laser: Array, spot: float,
             divergence: float) -> tuple[Array, Array]:
    """
    Return the sub-rays of beams in odom, each beam sent from where the vehicle is at its time.

    Parameters
    ----------
    poses
        (n, 6) of base_link in odom: x, y, z, roll, pitch, yaw.
    angles
        (n,) bearing of each beam in the scan plane, radians.
    T_base_laser
        (4, 4) mount.
    spot, divergence
        Diameter of the beam at its start in metres, full angle in radians.

    Returns
    -------
    origins, directions : Array
        (n k, 3), the `SUB_RAYS` of a beam together and its middle first; directions of unit
        length.

    """
    return _sub_rays(poses, angles, T_base_laser[:3, :3].copy(), T_base_laser[:3, 3].copy(),  # type: ignore
                     0.5 * spot * PATTERN, np.tan(0.5 * divergence) * PATTERN)


def echo_range(distance: Array, energy: Array, echo: str = 'pulse') -> tuple[Array, Array]:
    """
    Return the range each beam reports and the light it got back.

    Parameters
    ----------
    distance
        (n, k) metres of each beam's k sub-rays, +inf for no hit.
    energy
        (n, k) light from each sub-ray; that of sub-rays without a hit is ignored.
    echo
        One of `ECHOES`: 'pulse' as described above; 'near side' and 'middle' are the simpler ones.

    Returns
    -------
    ranges : Array
        (n,) metres, +inf where nothing came back.
    total : Array
        (n,) sum of the energies.

    """
    if echo == 'near side':
        return _near_side_range(distance, energy)  # type: ignore[no-any-return]
    if echo == 'middle':
        return _middle_range(distance, energy)  # type: ignore[no-any-return]
    return _echo_range(distance, energy, RISE, _normal_quantile(TRIGGER), TRIGGER)  # type: ignore


def _normal_quantile(fraction: float) -> float:
    """Return z with Phi(z) = fraction, by bisection: once a call, not worth a dependency."""
    low, high = -8.0, 8.0
    for _ in range(60):
        z = 0.5 * (low + high)
        low, high = (z, high) if 0.5 * math.erfc(-z / math.sqrt(2.0)) < fraction else (low, z)
    return 0.5 * (low + high)


@numba.njit(cache=True)
def _echo_range(distance, energy, rise, offset, trigger):  # type: ignore[no-untyped-def]
    """Solve sum_i e_i Phi((x - d_i) / rise + offset) = trigger sum_i e_i for x, per beam."""
    n, k = distance.shape
    ranges = np.full(n, np.inf)
    total = np.zeros(n)
    for i in range(n):
        near, far, mean = np.inf, 0.0, 0.0
        for j in range(k):
            if distance[i, j] < np.inf and energy[i, j] > 0.0:
                near = min(near, distance[i, j])
                far = max(far, distance[i, j])
                total[i] += energy[i, j]
                mean += energy[i, j] * distance[i, j]
        if total[i] <= 0.0:
            continue
        mean /= total[i]
        if far - near < 0.005:  # there the mean is right to 0.02 mm
            ranges[i] = mean
            continue
        # Newton's method, kept between the nearest and the farthest by bisection
        x = near
        while far - near > 1e-5:
            risen, slope = -trigger * total[i], 0.0
            for j in range(k):
                if distance[i, j] < np.inf:
                    z = (x - distance[i, j]) / rise + offset
                    risen += energy[i, j] * 0.5 * math.erfc(-z * math.sqrt(0.5))
                    slope += energy[i, j] * math.exp(-0.5 * z * z)
            if risen < 0.0:
                near = x
            else:
                far = x
            step = -risen * rise * math.sqrt(2.0 * math.pi) / max(slope, 1e-300)
            x += step
            if not near < x < far:
                x = 0.5 * (near + far)
            elif abs(step) < 1e-6:
                break
        ranges[i] = x
    return ranges, total


@numba.njit(cache=True)
def _near_side_range(distance, energy):  # type: ignore[no-untyped-def]
    """Return ranges (n,), the near side's where a footprint is deep, and the light got back."""
    ranges = np.full(len(distance), np.inf)
    total = np.zeros(len(distance))
    for i in range(len(distance)):
        near, far, moment = np.inf, 0.0, 0.0
        for j in range(distance.shape[1]):
            if distance[i, j] < np.inf and energy[i, j] > 0.0:
                near, far = min(near, distance[i, j]), max(far, distance[i, j])
                total[i] += energy[i, j]
                moment += energy[i, j] * distance[i, j]
        if total[i] <= 0.0:
            continue
        mean, depth = moment / total[i], far - near
        if depth < APART:
            t = min(max((depth - NEAR_FROM) / (NEAR_TO - NEAR_FROM), 0.0), 1.0)
            t = t * t * (3.0 - 2.0 * t)
            ranges[i] = (1.0 - t) * mean + t * (near + NEAR_SHARE * depth)
        else:
            ranges[i] = near if distance[i, 0] < near + 0.5 * depth else mean
    return ranges, total


@numba.njit(cache=True)
def _middle_range(distance, energy):  # type: ignore[no-untyped-def]
    """Return ranges (n,) of the middle, or the mean at edges, and the light got back."""
    ranges = np.full(len(distance), np.inf)
    total = np.zeros(len(distance))
    for i in range(len(distance)):
        moment, plain, hits = 0.0, 0.0, 0
        for j in range(distance.shape[1]):
            if distance[i, j] < np.inf:
                plain += distance[i, j]
                hits += 1
                if energy[i, j] > 0.0:
                    total[i] += energy[i, j]
                    moment += energy[i, j] * distance[i, j]
        if total[i] <= 0.0:
            continue
        whole = hits == distance.shape[1] and abs(plain / hits - distance[i, 0]) < UNEVEN
        ranges[i] = distance[i, 0] if whole else moment / total[i]
    return ranges, total


@numba.njit(cache=True)
def _sub_rays(  # type: ignore[no-untyped-def]
    poses, angles, R_base_laser, mount, start, spread,
):
    n, k = len(angles), len(start)
    origins = np.empty((n * k, 3))
    directions = np.empty((n * k, 3))
    R = np.empty((3, 3))
    for i in range(n):
        sr, cr = math.sin(poses[i, 3]), math.cos(poses[i, 3])
        sp, cp = math.sin(poses[i, 4]), math.cos(poses[i, 4])
        sy, cy = math.sin(poses[i, 5]), math.cos(poses[i, 5])
        c, s = math.cos(angles[i]), math.sin(angles[i])
        R[0, 0], R[0, 1], R[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
        R[1, 0], R[1, 1], R[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
        R[2, 0], R[2, 1], R[2, 2] = -sp, cp * sr, cp * cr
        for m in range(3):
            at = poses[i, m]
            ahead, within, normal = 0.0, 0.0, 0.0
            for q in range(3):
                at += R[m, q] * mount[q]
                ahead += R[m, q] * (c * R_base_laser[q, 0] + s * R_base_laser[q, 1])
                within += R[m, q] * (c * R_base_laser[q, 1] - s * R_base_laser[q, 0])
                normal += R[m, q] * R_base_laser[q, 2]
            # across the beam: within the scan plane, and along its normal
            for j in range(k):
                u, v = spread[j, 0], spread[j, 1]
                directions[i * k + j, m] = (ahead + u * within + v * normal) / math.sqrt(
                    1.0 + u * u + v * v)
                origins[i * k + j, m] = at + start[j, 0] * within + start[j, 1] * normal
    return origins, directions
