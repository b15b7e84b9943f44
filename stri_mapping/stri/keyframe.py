# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Keyframes: the scans of a moment merged into one dense profile of short lines.

Several turns of the mirror, each ray put where the spline says the scanner was at the ray's own
time, see every small face with many rays.  What is fitted to neighbouring points (see `surfel`)
is sorted by bearing, so that another keyframe finds its partners without a search tree.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.edges import find_edge
from stri_mapping.stri.rays import (
    BEARING,
    BRIGHTNESS,
    IN_ROW,
    LABEL,
    LONE,
    RANGE,
    SIGHT_ONLY,
    TIME,
)
from stri_mapping.stri.spline import pose_at
from stri_mapping.stri.surfel import (
    fit,
    neighbours,
    number_runs,
    running_sums,
    S_BEARING,
    S_LABEL,
    WINDOWS,
    X,
    Y,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SPARSE = 500               # rays of a keyframe below which the widest window and few points serve
BINS = 720
SIGHTS = 240              # lines of sight over the full circle


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def build(
    rays: Array, knots: Array, h: float, moment: float, angle_step: float, stride: int,
    surfels: Array, bins: NDArray[np.int32], edges: Array, edge_bins: NDArray[np.int32],
    sight: Array,
) -> tuple[int, int]:
    """
    Merge rays into the surfels of a keyframe.

    Parameters
    ----------
    rays
        (n, RAY) prepared rays of one or more scans.
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
    edges, edge_bins
        The same of reflectance edges, see `edges.find_edge`.
    sight
        (SIGHTS,) written, see `look`.

    Returns
    -------
    tuple
        Number of surfels and of edges written.

    """
    points, bearings = merge(rays, knots, h, moment)
    look(points, bearings, sight)
    sparse = len(rays) < SPARSE
    lines_of_sight = (rays[:, LONE] == SIGHT_ONLY) | (sparse & (rays[:, LONE] == IN_ROW))
    use = np.flatnonzero(~lines_of_sight)
    order = use[np.argsort(bearings[use])]
    n = len(order)
    xy, lone, brightness = points[order], rays[order, LONE], rays[order, BRIGHTNESS]
    runs = number_runs(xy)
    sums = running_sums(xy, rays[order, RANGE], lone)
    low, high = np.empty((len(WINDOWS), n), np.int32), np.empty((len(WINDOWS), n), np.int32)
    for w in range(0 if sparse else 1, len(WINDOWS)):
        neighbours(xy, runs, WINDOWS[w], low[w], high[w])
    bright = np.isfinite(brightness).any()
    count = found = 0
    for i in range(0, n, stride):
        if count == len(surfels):
            break
        if fit(i, xy, lone, sums, low, high, sparse, angle_step, surfels[count]):
            surfels[count, S_BEARING] = bearings[order[i]]
            surfels[count, S_LABEL] = rays[order[i], LABEL]
            if bright and lone[i] == 0.0 and found < len(edges) and find_edge(
                    xy, lone, brightness, low[1, i], high[1, i], surfels[count], edges[found]):
                edges[found, S_BEARING] = math.atan2(edges[found, Y], edges[found, X])
                edges[found, S_LABEL] = surfels[count, S_LABEL]
                found += 1
            count += 1
    _fill_bins(surfels, count, bins)
    edges[:found] = edges[np.argsort(edges[:found, S_BEARING])]
    _fill_bins(edges, found, edge_bins)
    return count, found


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def merge(rays: Array, knots: Array, h: float, moment: float) -> tuple[Array, Array]:
    """Return points (n, 2) in the frame at the moment, and their bearings (n,), see `build`."""
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
