# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The scanner's systematic range error, learnt from the straightness of walls.

A range that is long by b0 on a surface, or short by b1 (r tan(incidence))^2 because the near
side of a slanted footprint answers first, bends a straight wall.  A bent wall that passes by
turns the estimated heading by its curvature per metre driven, degrees in a street; yet a real
wall's own bends pass through all angles of incidence, and the sensor's do not.  So both
coefficients are fitted to all walls seen over the last stretch of the drive.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.keyframe import FACING, NX, NY, PULL, X, Y

Array = NDArray[np.float64]

# Before any wall is seen: no offset (data sheet: up to 3.5 cm), and a pull of 1 cm at
# r tan(incidence) = 10 m, give or take as much.
MEAN = np.array([0.0, 0.0])
SIGMA = np.array([0.015, 1e-4])
MEMORY = 60.0         # metres of path after which a wall counts 1/e
SAME_POINTS = 30.0    # neighbouring surfels share points: so many count as one
WALLS = 3             # looked for in a keyframe
MIN_LENGTH = 6.0      # metres of a wall from which its bend can be told
SCALE = 0.02          # metres from the line at which a surfel counts half


class RangeError:
    """Running estimate of (b0, b1): metres, and metres per square metre."""

    def __init__(self) -> None:
        """Start from the prior."""
        self._information = np.diag(SIGMA ** -2.0)
        self._evidence = np.zeros((2, 2))
        self._slope = np.zeros(2)
        self.value = MEAN.copy()

    def learn(self, surfels: Array, travelled: float) -> None:
        """
        Take the walls of one keyframe.

        Parameters
        ----------
        surfels
            (n, SURFEL) of the keyframe, uncorrected.
        travelled
            Metres since the keyframe before, by which older walls are forgotten.

        """
        fade = math.exp(-travelled / MEMORY)
        self._evidence *= fade
        self._slope *= fade
        use = np.ones(len(surfels), np.bool_)
        for _ in range(WALLS):
            if not _add_wall(surfels, use, self.value, self._evidence, self._slope):
                break
        right = self._slope + self._information @ MEAN
        self.value = np.linalg.solve(self._evidence + self._information, right)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _add_wall(
    surfels: Array, use: NDArray[np.bool_], value: Array, evidence: Array, slope: Array,
) -> bool:
    """Find the longest wall among the surfels in use, add what it tells, and use it up."""
    angle, offset = _longest(surfels, use)
    if math.isnan(angle):
        return False
    nx, ny = math.cos(angle), math.sin(angle)
    matrix, right = np.zeros((4, 4)), np.zeros(4)
    line = np.zeros(4)
    line[0] = offset
    row = np.empty(4)
    low, high, total, spread = 0.0, 0.0, 0.0, 0.0
    for iteration in range(4):
        scale = SCALE * (4.0, 2.0, 1.0, 1.0)[iteration]
        matrix[:], right[:] = 0.0, 0.0
        low, high, total, spread = np.inf, -np.inf, 0.0, 0.0
        for k in range(len(surfels)):
            along = -ny * surfels[k, X] + nx * surfels[k, Y]
            across = nx * surfels[k, X] + ny * surfels[k, Y]
            facing = nx * surfels[k, NX] + ny * surfels[k, NY]
            if not use[k] or abs(facing) < 0.98 or abs(across - offset - line[1] * along) > 0.3:
                continue
            sign = 1.0 if facing > 0.0 else -1.0
            # a range long by e moves the surfel by -e cos(incidence) along its normal
            row[0], row[1] = 1.0, along
            row[2], row[3] = -sign * surfels[k, FACING], sign * surfels[k, PULL]
            e = across - (line[0] + line[1] * along)
            if iteration > 0:
                e -= line[2] * row[2] + line[3] * row[3]
            else:
                e -= value[0] * row[2] + value[1] * row[3]
            if abs(e) > 5.0 * scale:
                if iteration == 3 and abs(e) < 0.15:
                    use[k] = False
                continue
            w = 1.0 / (1.0 + (e / scale) ** 2) ** 2
            total += w
            spread += w * e * e
            low, high = min(low, along), max(high, along)
            for i in range(4):
                right[i] += w * row[i] * across
                for j in range(4):
                    matrix[i, j] += w * row[i] * row[j]
            if iteration == 3:
                use[k] = False
        if total < 40.0 or high - low < MIN_LENGTH:
            return bool(total > 0.0 and iteration == 3)
        if iteration < 3:
            # the bend is weakly determined by one wall: hold it near what is known
            held, target = matrix.copy(), right.copy()
            for i in range(2):
                weight = (0.01 / SIGMA[i]) ** 2
                held[2 + i, 2 + i] += weight
                target[2 + i] += weight * value[i]
            line[:] = np.linalg.solve(held, target)
    variance = max(spread / total, 0.004 ** 2) * SAME_POINTS
    # the line itself is not of interest: Schur complement
    cross = matrix[2:, :2].copy()
    given = cross @ np.linalg.inv(matrix[:2, :2].copy())
    evidence += (matrix[2:, 2:] - given @ cross.T) / variance
    slope += (right[2:] - given @ right[:2]) / variance
    return True


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _longest(surfels: Array, use: NDArray[np.bool_]) -> tuple[float, float]:
    """Return normal angle and offset of the line most surfels lie on, NaN where too few do."""
    votes = np.zeros(180)
    for k in range(len(surfels)):
        if use[k]:
            votes[int(math.degrees(math.atan2(surfels[k, NY], surfels[k, NX])) + 180.0)
                  % 180] += 1.0
    smooth = votes + np.roll(votes, 1) + np.roll(votes, -1)
    best = int(np.argmax(smooth))
    if smooth[best] < 60.0:
        return np.nan, 0.0
    # mean direction of the bin, normals half a turn apart counting as one
    c, s = 0.0, 0.0
    for k in range(len(surfels)):
        a = math.atan2(surfels[k, NY], surfels[k, NX])
        if use[k] and abs((math.degrees(a) - best - 0.5 + 90.0) % 180.0 - 90.0) < 1.5:
            c += math.cos(2.0 * a)
            s += math.sin(2.0 * a)
    angle = 0.5 * math.atan2(s, c)
    nx, ny = math.cos(angle), math.sin(angle)
    offsets = np.zeros(1200)
    for k in range(len(surfels)):
        if use[k] and abs(nx * surfels[k, NX] + ny * surfels[k, NY]) > 0.98:
            b = int((nx * surfels[k, X] + ny * surfels[k, Y]) / 0.1 + 600.0)
            if 0 <= b < 1200:
                offsets[b] += 1.0
    smooth = offsets + np.roll(offsets, 1) + np.roll(offsets, -1)
    best = int(np.argmax(smooth))
    if smooth[best] < 40.0:
        return np.nan, 0.0
    return angle, (best + 0.5 - 600.0) * 0.1
