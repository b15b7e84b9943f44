# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Step 2 of the paper: surfaces in space and time, and the edges where one hides another.

A scan is cut where neighbouring rays do not continue one another.  Along a flat face 1/r is
linear in (cos, sin) of the bearing, so a face seen at grazing incidence continues although its
range runs away from ray to ray; a jump in depth does not.  A piece that lies over the same rays
at about the same range as one of the scan before is the same surface, a moment later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.scan import Scan

Array = NDArray[np.float64]
Labels = NDArray[np.int32]

UNLABELLED = -1
# Depth step between two surfaces: the sensor's noise and quantisation (1 cm each) leave 5 cm
# certain; window recesses start at about 10 cm.  Beam divergence spoils it with distance.
STEP, STEP_PER_RANGE = 0.06, 0.01
MIN_RAYS = 3


@dataclass(frozen=True, eq=False)
class Edges:
    """
    Occluding edges of one scan, each the end of the nearer surface at a jump in depth.

    Attributes
    ----------
    points
        (n, 2) in the scanner frame in metres, half a ray beyond the last ray on the surface:
        the edge lies between that ray and the next one, and the middle has no bias.
    times
        (n,) seconds since the scan's stamp.
    sides
        (n,) +1 where the surface ends towards growing bearing, -1 where it begins.

    """

    points: Array
    times: Array
    sides: NDArray[np.int8]


class Segmenter:
    """Cuts scan after scan into surfaces that keep their number while they are in view."""

    def __init__(self) -> None:
        """Start with no surface known."""
        self._ranges = np.zeros(0)
        self._labels = np.zeros(0, dtype=np.int32)
        self._surfaces = 0

    def segment(self, scan: Scan) -> tuple[Labels, Edges]:
        """
        Cut the next scan into surfaces and find its occluding edges.

        Parameters
        ----------
        scan
            Any scan; rays that are not valid belong to no surface and end the one before.

        Returns
        -------
        labels : Labels
            (n,) number of the surface each ray met, `UNLABELLED` for rays on none.
        edges : Edges
            The occluding edges of surfaces with at least `MIN_RAYS` rays.

        """
        no_return = np.where(np.isposinf(scan.ranges), np.inf, np.nan)
        ranges = np.where(scan.valid, scan.ranges, no_return)
        pieces = np.empty(len(scan), dtype=np.int32)
        found = np.empty((2 * len(scan), 4))
        edges = found[:_segment(ranges, scan.angles, scan.times, pieces, found)]
        if len(self._ranges) != len(ranges):
            self._ranges = np.full(len(ranges), np.nan)
            self._labels = np.full(len(ranges), UNLABELLED, dtype=np.int32)
        labels = np.empty(len(scan), dtype=np.int32)
        self._surfaces = _follow(ranges, pieces, self._ranges, self._labels, self._surfaces,
                                 labels)
        self._ranges, self._labels = ranges, labels
        points = edges[:, :1] * np.column_stack([np.cos(edges[:, 1]), np.sin(edges[:, 1])])
        return labels, Edges(points, edges[:, 2].copy(), edges[:, 3].astype(np.int8))


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _continues(ranges: Array, cos2: float, j: int, step: int, end: int) -> bool:
    """Tell whether ray j + step lies on the line through rays j - step and j."""
    k = j - step
    if k < 0 or k == end or not np.isfinite(ranges[k]):
        return False
    inverse = cos2 / ranges[j] - 1.0 / ranges[k]
    if inverse <= 0.0:
        return False
    r = ranges[j + step]
    return abs(1.0 / inverse - r) < 0.5 * (STEP + STEP_PER_RANGE * r)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _edge(ranges: Array, angles: Array, times: Array, j: int, side: int, rays: int) -> Array:
    """Return (range, bearing, time, side) half a ray beyond ray j, along its surface."""
    half = 0.5 * side * (angles[1] - angles[0])
    back = j - side * min(3, rays - 1)
    slope = (ranges[j] - ranges[back]) / abs(j - back)
    limit = 0.05 * ranges[j]
    out = np.empty(4)
    out[0] = ranges[j] + 0.5 * min(max(slope, -limit), limit)
    out[1] = angles[j] + half
    out[2] = times[j] + 0.5 * side * (times[1] - times[0])
    out[3] = side
    return out


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _segment(ranges: Array, angles: Array, times: Array, labels: Labels, found: Array) -> int:
    n = len(ranges)
    label, count, start = 0, 0, 0
    labels[:] = UNLABELLED
    cos2 = 2.0 * np.cos(angles[1] - angles[0]) if n > 1 else 2.0
    for j in range(n):
        if not np.isfinite(ranges[j]):
            start = j + 1
            continue
        joined = False
        if j + 1 < n and np.isfinite(ranges[j + 1]):
            step = abs(ranges[j + 1] - ranges[j])
            joined = (step < STEP + STEP_PER_RANGE * min(ranges[j], ranges[j + 1])
                      or _continues(ranges, cos2, j, 1, n)
                      or (j + 2 < n and _continues(ranges, cos2, j + 1, -1, n)))
        if joined:
            continue
        rays = j - start + 1
        if rays >= MIN_RAYS:
            labels[start:j + 1] = label
            label += 1
            if start > 0 and ranges[start - 1] > ranges[start]:
                found[count] = _edge(ranges, angles, times, start, -1, rays)
                count += 1
            if j + 1 < n and ranges[j + 1] > ranges[j]:
                found[count] = _edge(ranges, angles, times, j, 1, rays)
                count += 1
        start = j + 1
    return count


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _follow(
    ranges: Array, pieces: Labels, ranges_before: Array, labels_before: Labels, surfaces: int,
    labels: Labels,
) -> int:
    """Number the pieces of a scan after the surfaces they continue; return how many there are."""
    n = len(ranges)
    labels[:] = UNLABELLED
    start = 0
    while start < n:
        end = start + 1
        while end < n and pieces[end] == pieces[start]:
            end += 1
        if pieces[start] != UNLABELLED:
            best, most = surfaces, 0
            votes = 0
            for j in range(start, end):
                if (labels_before[j] == UNLABELLED
                        or abs(ranges[j] - ranges_before[j]) > 3.0 * STEP + 0.05 * ranges[j]):
                    continue
                votes = votes + 1 if labels_before[j] == labels_before[j - 1] else 1
                if votes > most and not _taken(labels, labels_before[j]):
                    best, most = labels_before[j], votes
            labels[start:end] = best
            surfaces += best == surfaces
        start = end
    return surfaces


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _taken(labels: Labels, label: int) -> bool:
    for value in labels:
        if value == label:
            return True
    return False
