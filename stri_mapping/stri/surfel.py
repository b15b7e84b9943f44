# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Surface elements (surfels) from the merged points of a keyframe.

A line is fitted to the widest neighbourhood of a point that holds one straight line at the
sensor's noise, by running sums: constant time a point.  Each accepted point becomes a surfel: its
foot on the line, the line's normal, how sure the normal is, and how a pull towards the near side
of the footprint would show along the normal (see `range_error`).

Far down a street a face is met by one ray of a scan, or by none.  Its points are too few and too
far apart for a line, but where they lie over several turns tells a face from a wall that is
grazed: as the vehicle moves, a face stays in its place and its range changes; where a ray grazes
a wall the range stays, and the point moves along.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.rays import ray_sigma

Array = NDArray[np.float64]

# columns of a surfel, in the frame of the scanner at the keyframe's time
X, Y, NX, NY, NORMAL_VAR, S_BEARING, S_LABEL, PULL = range(8)
SURFEL = 8

GRAZING_FITTED = 0.3       # metres of range from ray to ray, as the fitted line has it
WINDOWS = (1.6, 0.8, 0.4, 0.2, 0.1)     # metres to either side
MIN_POINTS, MIN_POINTS_SPARSE = 6, 2
MIN_VARIANCE = 0.03 ** 2
HEAD_ON = 0.9
ALONE_VARIANCE = 0.1       # rad^2, of the normal where single rays met a face
# A face met by one ray of a scan: metres between rays, from where on they are looked for; points,
# at the least; metres of their scatter in range (footprints half on it come late); and how much
# wider than that it is seen, or its range changes, in variance.
FACE_SPACING, FACE_POINTS, FACE_SCATTER, FACE_CLEAR = 0.5, 4, 0.1, 4.0


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def number_runs(xy: Array) -> NDArray[np.int32]:
    """Return (n,) the number of the unbroken run each sorted point (n, 2) belongs to."""
    runs = np.zeros(len(xy), np.int32)
    for i in range(1, len(xy)):
        gap = math.hypot(xy[i, 0] - xy[i - 1, 0], xy[i, 1] - xy[i - 1, 1])
        runs[i] = runs[i - 1] + (gap > 0.2 + 0.02 * math.hypot(xy[i, 0], xy[i, 1]))
    return runs


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def running_sums(xy: Array, ranges: Array, lone: Array) -> Array:
    """
    Return running sums over sorted points.

    Parameters
    ----------
    xy, ranges, lone
        (n, 2) points in the keyframe's frame, their (n,) ranges as measured, and whether they
        are lone (see `rays.prepare_rays`).

    Returns
    -------
    Array
        (2, n + 1, 8) sums of 1, x, y, xx, yy, xy, range, range squared: of all points, and
        without lone ones.

    """
    n = len(xy)
    sums = np.zeros((2, n + 1, 8))
    for i in range(n):
        x, y, r = xy[i, 0], xy[i, 1], ranges[i]
        for kind in range(2):
            use = 1.0 if kind == 0 or lone[i] == 0.0 else 0.0
            sums[kind, i + 1, 0] = sums[kind, i, 0] + use
            sums[kind, i + 1, 1] = sums[kind, i, 1] + use * x
            sums[kind, i + 1, 2] = sums[kind, i, 2] + use * y
            sums[kind, i + 1, 3] = sums[kind, i, 3] + use * x * x
            sums[kind, i + 1, 4] = sums[kind, i, 4] + use * y * y
            sums[kind, i + 1, 5] = sums[kind, i, 5] + use * x * y
            sums[kind, i + 1, 6] = sums[kind, i, 6] + use * r
            sums[kind, i + 1, 7] = sums[kind, i, 7] + use * r * r
    return sums


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def neighbours(
    xy: Array, runs: NDArray[np.int32], width: float, low: NDArray[np.int32],
    high: NDArray[np.int32],
) -> None:
    """Write the index range [low, high) of the points within a width on the same run."""
    n = len(xy)
    lo = hi = 0
    for i in range(n):
        hi = max(hi, i)
        while runs[lo] != runs[i] or _far(xy, lo, i, width):
            lo += 1
        while hi + 1 < n and runs[hi + 1] == runs[i] and not _far(xy, hi + 1, i, width):
            hi += 1
        low[i], high[i] = lo, hi + 1


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _far(xy: Array, i: int, j: int, width: float) -> bool:
    dx, dy = xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1]
    return bool(dx * dx + dy * dy > width * width)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def fit(
    i: int, xy: Array, lone: Array, sums: Array, low: NDArray[np.int32],
    high: NDArray[np.int32], sparse: bool, angle_step: float, surfel: Array,
) -> bool:
    """
    Write the surfel of a point: a face met by single rays, or the widest window's straight line.

    Parameters
    ----------
    i
        Index of the point among the sorted ones.
    xy, lone, sums
        See `running_sums`.
    low, high
        (len(WINDOWS), n) neighbours of each point in every window, see `neighbours`; those of
        the widest window are used of sparse keyframes only.
    sparse
        Whether the keyframe has few rays.
    angle_step
        Radians between the rays of a scan.
    surfel
        (SURFEL,) written, but for bearing and label.

    Returns
    -------
    bool
        Whether there is a surfel.

    """
    x, y = xy[i, 0], xy[i, 1]
    r = math.hypot(x, y)
    if sparse and high[0, i] - low[0, i] == 1:
        # far down a corridor this is all that tells the way
        _face_the_scanner(x, y, r, 0.0, surfel)
        return True
    kind = 1 if lone[i] == 0.0 else 0
    if kind == 0 and not sparse and r * angle_step > FACE_SPACING:
        begin, end = sums[0, low[1, i]], sums[0, high[1, i]]
        if _face(x, y, r, begin, end, surfel):
            return True
    nx, ny, offset, variance = straight(
        i, xy, sums[kind], low, high, 0 if sparse else 1,
        MIN_POINTS_SPARSE if sparse else MIN_POINTS)
    if variance == np.inf:
        return False
    facing = max(abs(nx * x + ny * y) / r, 0.05)
    step = r * angle_step * math.sqrt(max(0.0, 1.0 - facing * facing)) / facing
    surfel[X], surfel[Y] = x - offset * nx, y - offset * ny
    surfel[NX], surfel[NY] = nx, ny
    surfel[NORMAL_VAR] = variance
    surfel[PULL] = r * r * (1.0 - facing * facing) / facing
    return bool((kind == 1 or facing > HEAD_ON) and step < GRAZING_FITTED)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def straight(
    i: int, xy: Array, sums: Array, low: NDArray[np.int32], high: NDArray[np.int32],
    first: int, least: int,
) -> tuple[float, float, float, float]:
    """
    Fit a line to the widest neighbourhood of a point that holds one at the sensor's noise.

    Parameters
    ----------
    i, xy, low, high
        See `fit`.
    sums
        (n + 1, 8) running sums of the points that may bend the line.
    first
        Number of the widest window to be tried.
    least
        Points that it takes.

    Returns
    -------
    tuple
        The normal x, y towards the scanner; metres from the line to the point along it; variance
        of its direction, infinite where there is no line.

    """
    x, y = xy[i, 0], xy[i, 1]
    sigma = ray_sigma(math.hypot(x, y))
    for w in range(first, low.shape[0]):
        m, mx, my, xx, yy, xy_ = _moments(sums[low[w, i]], sums[high[w, i]])
        if m < least:
            break
        mean, spread = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy_ * xy_)
        long, thick = mean + spread, max(mean - spread, 0.0)
        if (thick * m / max(m - 2.0, 1.0) >= (1.4 * sigma) ** 2 or long <= 8.0 * thick
                or long <= MIN_VARIANCE):
            continue
        angle = 0.5 * math.atan2(2.0 * xy_, xx - yy)
        nx, ny = -math.sin(angle), math.cos(angle)
        offset = (x - mx) * nx + (y - my) * ny
        if abs(offset) >= 2.5 * sigma:
            continue
        variance = sigma * sigma / (m * long)
        if nx * x + ny * y > 0.0:
            return -nx, -ny, -offset, variance
        return nx, ny, offset, variance
    return 0.0, 0.0, 0.0, np.inf


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _moments(begin: Array, end: Array) -> tuple[float, float, float, float, float, float]:
    """Return number, means and central second moments xx, yy, xy between two running sums."""
    m = end[0] - begin[0]
    if m == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    mx, my = (end[1] - begin[1]) / m, (end[2] - begin[2]) / m
    return (m, mx, my, (end[3] - begin[3]) / m - mx * mx, (end[4] - begin[4]) / m - my * my,
            (end[5] - begin[5]) / m - mx * my)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _face(x: float, y: float, r: float, begin: Array, end: Array, surfel: Array) -> bool:
    """Write the surfel of a face that single rays of several scans met, if it is one."""
    m, mx, my, xx, yy, xy = _moments(begin, end)
    if m < FACE_POINTS:
        return False
    cos, sin = x / r, y / r
    depth = cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy
    width = xx + yy - depth
    mean = (end[6] - begin[6]) / m
    approach = (end[7] - begin[7]) / m - mean * mean
    wide = width > max(FACE_CLEAR * depth, MIN_VARIANCE)
    if depth > FACE_SCATTER ** 2 or not (wide or approach > FACE_CLEAR * depth):
        return False
    offset = (x - mx) * cos + (y - my) * sin
    if abs(offset) > 2.0 * FACE_SCATTER:
        return False
    _face_the_scanner(x, y, r, offset, surfel)
    return True


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _face_the_scanner(x: float, y: float, r: float, offset: float, surfel: Array) -> None:
    """Write the surfel of a face seen from the front, by an offset nearer than a point."""
    cos, sin = x / r, y / r
    surfel[X], surfel[Y], surfel[NX], surfel[NY] = x - offset * cos, y - offset * sin, -cos, -sin
    surfel[NORMAL_VAR], surfel[PULL] = ALONE_VARIANCE, 0.0
