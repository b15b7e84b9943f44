# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Straight runs within vertical scan lines: road, walls, and the rest.

A scan line is cut where its points leave a straight line.  All is done in the scan plane, with
t horizontal and v upwards, metres from the scanner; `Run` rows hold what a run is known by.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Of points (t, v): their count, sums of t and v, and of t t, t v and v v.
Sums = tuple[float, float, float, float, float, float]

# A point belongs to a run while it is this near to its line, metres: four standard deviations of
# the range noise.  One that is not is skipped if the next is again.
TOLERANCE = 0.04
# Openings up to this long are bridged, metres.
OPENING = 1.5
# Columns of the table of runs.
FIRST, LAST, COUNT, MEAN_T, MEAN_V, DIR_T, DIR_V, LENGTH, RMS = range(9)
RUN_FIELDS = 9


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def find_runs(t: Array, v: Array, runs: Array, member: NDArray[np.int32]) -> int:
    """
    Cut one scan line into straight runs.

    Parameters
    ----------
    t, v
        (n,) points of the line in the order of its rays, metres in the scan plane.
    runs
        (>= n, RUN_FIELDS) written: first and last point, count, mean, direction (unit, v >= 0),
        length from end to end and root mean square distance from the line, in metres.
    member
        (n,) written: the run of each point, -1 for those between runs.

    Returns
    -------
    int
        Number of runs, of three points at least.

    """
    n, count, i = len(t), 0, 0
    while i < n:
        s = _add((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), t[i], v[i])
        member[i] = count
        last, j, misses, members = i, i + 1, 0, 1
        x, y = 0.0, 0.0
        while j < n and misses < 2:
            gap = (t[j] - t[last]) ** 2 + (v[j] - v[last]) ** 2
            if members < 2:
                # no line yet: neighbouring rays of one surface met at up to 75 degrees or so
                fits = gap < (0.3 + 0.07 * math.sqrt(t[j] ** 2 + v[j] ** 2)) ** 2
            else:
                off = (members * t[j] - s[1]) * y - (members * v[j] - s[2]) * x
                fits = gap < OPENING**2 and abs(off) < members * TOLERANCE
            if fits:
                s, members = _add(s, t[j], v[j]), members + 1
                if members < 8 or members % 4 == 0:     # a long line turns slowly
                    x, y, _ = _spread(s)
                member[j] = count
                last, misses = j, 0
            else:
                member[j] = -1
                misses += 1
            j += 1
        if members >= 3:
            _write(runs[count], s, i, last, t, v)
            count += 1
        else:
            for k in range(i, last + 1):
                member[k] = -1
        i = last + 1
    return count


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _add(s: Sums, t: float, v: float) -> Sums:
    return (s[0] + 1.0, s[1] + t, s[2] + v, s[3] + t * t, s[4] + t * v, s[5] + v * v)


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _spread(s: Sums) -> tuple[float, float, float]:
    """Return the direction of most spread, and the variance across it."""
    share = 1.0 / s[0]
    t, v = share * s[1], share * s[2]
    tt, tv, vv = share * s[3] - t * t, share * s[4] - t * v, share * s[5] - v * v
    root = math.sqrt(0.25 * (tt - vv) ** 2 + tv * tv)
    small = 0.5 * (tt + vv) - root
    # the longer of the two rows of (C - small) tells the direction without cancellation
    if tt > vv:
        x, y = 0.5 * (tt - vv) + root, tv
    else:
        x, y = tv, 0.5 * (vv - tt) + root
    norm = math.sqrt(x * x + y * y)
    if norm == 0.0:
        return 1.0, 0.0, small
    if y < 0.0:
        norm = -norm
    return x / norm, y / norm, small


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _write(run: Array, s: Sums, first: int, last: int, t: Array, v: Array) -> None:
    x, y, small = _spread(s)
    run[FIRST], run[LAST], run[COUNT] = first, last, s[0]
    run[MEAN_T], run[MEAN_V] = s[1] / s[0], s[2] / s[0]
    run[DIR_T], run[DIR_V] = x, y
    run[LENGTH] = abs((t[last] - t[first]) * x + (v[last] - v[first]) * y)
    run[RMS] = math.sqrt(max(small, 0.0))
