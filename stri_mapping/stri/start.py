# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The slope idea at the start: which speed makes the range image continue itself?

The range profile of a scan some time later is predicted from a scan for every speed that a
vehicle may have; the speed that predicts best is taken.  Unlike matching of nearest neighbours
this does not prefer "nothing moved": a wall met by the same bearings again and again agrees
with every speed, and only what stands out of it decides.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.scan import Scan

Array = NDArray[np.float64]

FAR = 30.0           # metres; beyond, a ray's footprint is wider than what is to be seen
CAP = 0.25           # metres beyond which a difference of ranges says "something else"
SPEEDS = np.arange(-20.0, 20.01, 0.1)
LAGS = (0.1, 0.25, 0.45)


def propose_speed(scans: Sequence[Scan], R_base_laser: Array) -> tuple[float, float]:
    """
    Return the forward speed that best predicts each scan from earlier ones.

    Parameters
    ----------
    scans
        Scans of about half a second, oldest first, at least two.
    R_base_laser
        (2, 2) rotation of the laser's plane into base_link's.

    Returns
    -------
    speed : float
        m/s along base_link's x axis.
    cost : float
        Mean capped difference of ranges in metres at that speed; `CAP` where nothing overlaps.

    """
    ranges = np.full((len(scans), max(map(len, scans))), np.nan)
    for row, scan in zip(ranges, scans):
        row[:len(scan)] = np.where(scan.valid & (scan.ranges < FAR), scan.ranges, np.nan)
    first = np.array([s.angles[0] for s in scans])
    step = float(scans[0].angles[1] - scans[0].angles[0])
    times = np.array([(s.stamp_ns - scans[0].stamp_ns) * 1e-9 for s in scans])
    forward = R_base_laser.T @ np.array([1.0, 0.0])
    costs = _costs(ranges, times, first, step, forward, SPEEDS, np.array(LAGS))
    best = int(np.argmin(costs))
    return float(SPEEDS[best]), float(costs[best])


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _costs(
    ranges: Array, times: Array, first: Array, step: float, forward: Array, speeds: Array,
    lags: Array,
) -> Array:
    scans, rays = ranges.shape
    total, weight = np.zeros(len(speeds)), np.full(len(speeds), 1e-9)
    for i in range(0, scans, 1 + scans // 12):
        for lag in lags:
            k = int(np.searchsorted(times, times[i] + lag))
            if k >= scans:
                break
            if k == i:
                continue
            for j in range(rays):
                if np.isfinite(ranges[i, j]):
                    x = ranges[i, j] * np.cos(first[i] + step * j)
                    y = ranges[i, j] * np.sin(first[i] + step * j)
                    for s in range(len(speeds)):
                        shift = speeds[s] * (times[k] - times[i])
                        px, py = x - shift * forward[0], y - shift * forward[1]
                        r, u = np.hypot(px, py), (np.arctan2(py, px) - first[k]) / step
                        if 0.0 < u < rays - 1:
                            a, b = ranges[k, int(u)], ranges[k, int(u) + 1]
                            total[s] += _difference(r, a, b)
                            weight[s] += 1.0
    return total / weight


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _difference(r: float, a: float, b: float) -> float:
    """Return how far a range is from the two rays around it, between them counting as on."""
    if abs(a - b) < 1.0 and min(a, b) <= r <= max(a, b):
        return 0.0
    d = min(abs(a - r), abs(b - r))
    return min(d, CAP) if np.isfinite(d) else CAP
