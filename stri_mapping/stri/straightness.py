# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The pull of slanted footprints as the bend of single walls, see `range_error`."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.surfel import NX, NY, PULL, X, Y

Array = NDArray[np.float64]

MEMORY = 200.0        # metres of path over which walls are remembered
SAME_WALL = 5.0       # keyframes see the same wall again and again: so many count as one
WALLS = 3             # looked for in a keyframe
MIN_LENGTH = 6.0      # metres of a wall from which its bend can be told
SCALE = 0.02          # metres from the line at which a surfel counts half


class Bends:
    """What the walls of the last stretch of the drive say of the pull."""

    def __init__(self) -> None:
        """Start with none."""
        self._walls: list[tuple[float, float, float]] = []     # path, b, variance of b

    def add(self, surfels: Array, travelled: float, known: float) -> None:
        """
        Take the walls of one keyframe.

        Parameters
        ----------
        surfels
            (n, SURFEL) of the keyframe, uncorrected.
        travelled
            Metres of path so far; what lies `MEMORY` behind is forgotten.
        known
            The pull as known so far, 1/m.

        """
        use = np.ones(len(surfels), np.bool_)
        for _ in range(WALLS):
            found, b, variance = _wall(surfels, use, known)
            if not found:
                break
            if variance < np.inf:
                self._walls.append((travelled, b, variance))
        self._walls = [w for w in self._walls if travelled - w[0] < MEMORY]

    def mean(self) -> tuple[float, float]:
        """
        Return the walls' robust mean (Geman-McClure) in 1/m, and the information behind it.

        How straight walls are in this street is read from how much they differ (median absolute
        deviation); where two planes were taken for one they differ wildly.
        """
        if not self._walls:
            return 0.0, 0.0
        value, variance = np.array(self._walls).T[1:]
        z = (value - np.median(value)) / np.sqrt(variance)
        variance = variance * max(1.48 * float(np.median(np.abs(z))), 0.3) ** 2
        mean = float(np.median(value))
        for _ in range(10):
            robust = (1.0 + (value - mean) ** 2 / (4.0 * variance)) ** -2.0 / variance / SAME_WALL
            mean = float(robust @ value / robust.sum())
        return mean, float(robust.sum())


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def commonest_normal(surfels: Array, use: NDArray[np.bool_]) -> int:
    """Return in degrees, 0 to 179, where most normals of surfels in use lie, -1 if too few do."""
    votes = np.zeros(180)
    for k in range(len(surfels)):
        if use[k]:
            votes[int(math.degrees(math.atan2(surfels[k, NY], surfels[k, NX])) + 180.0)
                  % 180] += 1.0
    smooth = votes + np.roll(votes, 1) + np.roll(votes, -1)
    best = int(np.argmax(smooth))
    return best if smooth[best] >= 60.0 else -1


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _wall(
    surfels: Array, use: NDArray[np.bool_], known: float,
) -> tuple[bool, float, float]:
    """
    Find the longest wall among the surfels in use, and use it up.

    Returns whether there was one, its b, and the variance of that, infinite where it is too
    short to tell.
    """
    angle, offset = _longest(surfels, use)
    if math.isnan(angle):
        return False, 0.0, np.inf
    nx, ny = math.cos(angle), math.sin(angle)
    fit, row = np.array([offset, 0.0, known]), np.empty(3)
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for iteration in range(4):
        scale = SCALE * (4.0, 2.0, 1.0, 1.0)[iteration]
        matrix[:], right[:] = 0.0, 0.0
        low, high, total, spread = np.inf, -np.inf, 0.0, 0.0
        for k in range(len(surfels)):
            facing = nx * surfels[k, NX] + ny * surfels[k, NY]
            if not use[k] or abs(facing) < 0.98:
                continue
            across = nx * surfels[k, X] + ny * surfels[k, Y]
            # a range short by e moves the surfel by e cos(incidence) along its normal
            row[0], row[1] = 1.0, -ny * surfels[k, X] + nx * surfels[k, Y]
            row[2] = surfels[k, PULL] if facing > 0.0 else -surfels[k, PULL]
            e = across - (fit[0] + fit[1] * row[1] + fit[2] * row[2])
            if abs(e) > 5.0 * scale:
                use[k] = iteration < 3 or abs(e) > 0.15
                continue
            use[k] = iteration < 3
            w = 1.0 / (1.0 + (e / scale) ** 2) ** 2
            total += w
            spread += w * e * e
            low, high = min(low, row[1]), max(high, row[1])
            for i in range(3):
                right[i] += w * row[i] * across
                for j in range(3):
                    matrix[i, j] += w * row[i] * row[j]
        if total < 40.0 or high - low < MIN_LENGTH:
            for k in range(len(surfels)):
                if abs(nx * surfels[k, X] + ny * surfels[k, Y] - offset) < 0.15:
                    use[k] = False
            return True, 0.0, np.inf
        fit = np.linalg.solve(matrix, right)
    return True, fit[2], max(spread / total, 0.004 ** 2) * np.linalg.inv(matrix)[2, 2] * 30.0


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _longest(surfels: Array, use: NDArray[np.bool_]) -> tuple[float, float]:
    """Return normal angle and offset of the line most surfels lie on, NaN where too few do."""
    best = commonest_normal(surfels, use)
    if best < 0:
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
