# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Keyframes: the scans of a moment merged into one dense profile of short lines.

Several turns of the mirror, each ray put where the spline says the scanner was at the ray's own
time, see every small face with many rays.  Lines are fitted to neighbouring points by running
sums; each accepted point becomes a surface element (surfel): its foot on the line, the line's
normal, how sure the normal is, and how a pull towards the near side of
the footprint would show along the normal (see `range_error`).
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.rays import BEARING, LABEL, LONE, RANGE, ray_sigma, SIGHT_ONLY, TIME
from stri_mapping.stri.spline import pose_at

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# columns of a surfel, in the frame of the scanner at the keyframe's time
X, Y, NX, NY, NORMAL_VAR, S_BEARING, S_LABEL, PULL = range(8)
SURFEL = 8

GRAZING_FITTED = 0.3       # metres of range from ray to ray, as the fitted line has it
SPARSE = 500               # rays of a keyframe below which the widest window and few points serve
WINDOWS = (1.6, 0.8, 0.4, 0.2, 0.1)     # metres to either side
MIN_POINTS, MIN_POINTS_SPARSE = 6, 2
ALONE_VARIANCE = 0.1       # rad^2, of the normal where a single ray met a face
MIN_VARIANCE = 0.03 ** 2
HEAD_ON = 0.9
BINS = 720
SIGHTS = 240              # lines of sight over the full circle


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def build(
    rays: Array, knots: Array, h: float, moment: float, angle_step: float, stride: int,
    surfels: Array, bins: NDArray[np.int32], sight: Array,
) -> int:
    """
    Merge rays into the surfels of a keyframe.

    Parameters
    ----------
    rays
        (n, 5) prepared rays of one or more scans.
    knots, h
        The spline by which each ray is put in its place, and its knot spacing.
    moment
        Time of the keyframe.
    angle_step
        Radians between the rays of a scan, for the footprint.
    stride
        Every stride-th point becomes a surfel.
    surfels
        (m, SURFEL) written, sorted by bearing; no more than m.
    bins
        (BINS + 1,) written: first surfel of each bearing bin, bins over the full circle.
    sight
        (SIGHTS,) written, see `look`.

    Returns
    -------
    int
        Number of surfels written.

    """
    points, bearings = _merge(rays, knots, h, moment)
    look(points, bearings, sight)
    use = np.flatnonzero(rays[:, LONE] != SIGHT_ONLY)
    order = use[np.argsort(bearings[use])]
    n = len(order)
    xy = np.empty((n, 2))
    lone = np.empty(n)
    for i in range(n):
        xy[i], lone[i] = points[order[i]], rays[order[i], LONE]
    runs = _runs(xy)
    sums = _running_sums(xy, lone)
    low, high = np.empty((len(WINDOWS), n), np.int32), np.empty((len(WINDOWS), n), np.int32)
    sparse = n < SPARSE
    for w in range(0 if sparse else 1, len(WINDOWS)):
        _neighbours(xy, runs, WINDOWS[w], low[w], high[w])
    count = 0
    for i in range(0, n, stride):
        if count == len(surfels):
            break
        if _fit(i, xy, lone, sums, low, high, sparse, angle_step, surfels[count]):
            surfels[count, S_BEARING] = bearings[order[i]]
            surfels[count, S_LABEL] = rays[order[i], LABEL]
            count += 1
    _fill_bins(surfels, count, bins)
    return count


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _merge(rays: Array, knots: Array, h: float, moment: float) -> tuple[Array, Array]:
    """Return points (n, 2) in the frame at the moment, and their bearings (n,)."""
    n = len(rays)
    points, bearings = np.empty((n, 2)), np.empty(n)
    weights, home, pose = np.empty(4), np.empty(3), np.empty(3)
    pose_at(knots, h, moment, weights, home)
    cos, sin = math.cos(home[2]), math.sin(home[2])
    for i in range(n):
        pose_at(knots, h, rays[i, TIME], weights, pose)
        a = rays[i, BEARING] + pose[2]
        dx = pose[0] - home[0] + rays[i, RANGE] * math.cos(a)
        dy = pose[1] - home[1] + rays[i, RANGE] * math.sin(a)
        points[i, 0], points[i, 1] = cos * dx + sin * dy, -sin * dx + cos * dy
        bearings[i] = math.atan2(points[i, 1], points[i, 0])
    return points, bearings


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _runs(xy: Array) -> NDArray[np.int32]:
    """Return (n,) the number of the unbroken run each sorted point belongs to."""
    runs = np.zeros(len(xy), np.int32)
    for i in range(1, len(xy)):
        gap = math.hypot(xy[i, 0] - xy[i - 1, 0], xy[i, 1] - xy[i - 1, 1])
        runs[i] = runs[i - 1] + (gap > 0.2 + 0.02 * math.hypot(xy[i, 0], xy[i, 1]))
    return runs


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _running_sums(xy: Array, lone: Array) -> Array:
    """Return (2, n + 1, 6) sums of 1, x, y, xx, yy, xy: of all points, and without lone ones."""
    n = len(xy)
    sums = np.zeros((2, n + 1, 6))
    for i in range(n):
        x, y = xy[i, 0], xy[i, 1]
        for kind in range(2):
            use = 1.0 if kind == 0 or lone[i] == 0.0 else 0.0
            sums[kind, i + 1, 0] = sums[kind, i, 0] + use
            sums[kind, i + 1, 1] = sums[kind, i, 1] + use * x
            sums[kind, i + 1, 2] = sums[kind, i, 2] + use * y
            sums[kind, i + 1, 3] = sums[kind, i, 3] + use * x * x
            sums[kind, i + 1, 4] = sums[kind, i, 4] + use * y * y
            sums[kind, i + 1, 5] = sums[kind, i, 5] + use * x * y
    return sums


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _neighbours(
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
def _fit(
    i: int, xy: Array, lone: Array, sums: Array, low: NDArray[np.int32],
    high: NDArray[np.int32], sparse: bool, angle_step: float, surfel: Array,
) -> bool:
    """Write the surfel of point i: the widest window's straight line, or a face met once."""
    x, y = xy[i, 0], xy[i, 1]
    r = math.hypot(x, y)
    sigma = ray_sigma(r)
    if sparse and high[0, i] - low[0, i] == 1:
        # far down a corridor this is all that tells the way; a face is seen from the front
        surfel[X], surfel[Y], surfel[NX], surfel[NY] = x, y, -x / r, -y / r
        surfel[NORMAL_VAR], surfel[PULL] = ALONE_VARIANCE, 0.0
        return True
    kind = 0 if lone[i] == 1.0 else 1
    for w in range(0 if sparse else 1, low.shape[0]):
        a, b = sums[kind, low[w, i]], sums[kind, high[w, i]]
        m = b[0] - a[0]
        if m < (MIN_POINTS_SPARSE if sparse else MIN_POINTS):
            return False
        mx, my = (b[1] - a[1]) / m, (b[2] - a[2]) / m
        xx, yy = (b[3] - a[3]) / m - mx * mx, (b[4] - a[4]) / m - my * my
        xy_ = (b[5] - a[5]) / m - mx * my
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
        if nx * x + ny * y > 0.0:
            nx, ny, offset = -nx, -ny, -offset
        facing = max(abs(nx * x + ny * y) / r, 0.05)
        step = r * angle_step * math.sqrt(max(0.0, 1.0 - facing * facing)) / facing
        surfel[X], surfel[Y] = x - offset * nx, y - offset * ny
        surfel[NX], surfel[NY] = nx, ny
        surfel[NORMAL_VAR] = sigma * sigma / (m * long)
        surfel[PULL] = r * r * (1.0 - facing * facing) / facing
        return bool((kind == 1 or facing > HEAD_ON) and step < GRAZING_FITTED)
    return False


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _fill_bins(surfels: Array, count: int, bins: NDArray[np.int32]) -> None:
    b = 0
    for k in range(count):
        q = bearing_bin(surfels[k, S_BEARING])
        while b <= q:
            bins[b] = k
            b += 1
    while b <= BINS:
        bins[b] = count
        b += 1


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def bearing_bin(bearing: float) -> int:
    """Return the bin of a bearing in [-pi, pi]."""
    return min(int((bearing + math.pi) * (BINS / (2.0 * math.pi))), BINS - 1)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def look(points: Array, bearings: Array, sight: Array) -> None:
    """
    Write how far rays go along each line of sight.

    Parameters
    ----------
    points, bearings
        (n, 2) returns in the keyframe's frame, and their (n,) bearings.
    sight
        (SIGHTS,) written with metres to the nearest of them, 0 where there is none.

    """
    sight[:] = 0.0
    for i in range(len(points)):
        q, r = sector(bearings[i]), math.hypot(points[i, 0], points[i, 1])
        if sight[q] == 0.0 or r < sight[q]:
            sight[q] = r


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def sector(bearing: float) -> int:
    """Return the line of sight of a bearing in [-pi, pi]."""
    return min(int((bearing + math.pi) * (SIGHTS / (2.0 * math.pi))), SIGHTS - 1)
