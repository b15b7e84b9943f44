# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Step 2 of the paper: surfaces in space and time.

A scan is cut where neighbouring rays do not continue one another.  Along a flat face 1/r is
linear in (cos, sin) of the bearing, so a face seen at grazing incidence continues although its
range runs away from ray to ray; a jump in depth does not.  A ray that meets about the same range
as the scan before at its bearing meets the same surface, a moment later, and the rest of its piece
follows it.  So surfaces that touch for a moment stay apart, and one that is cut by something in
front of it keeps its number on both sides.
"""

from __future__ import annotations

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
# Speed in m/s by which a surface may come nearer or go away at one bearing from scan to scan.
FAST = 12.0


class Segmenter:
    """Cuts scan after scan into surfaces that keep their number while they are in view."""

    def __init__(self) -> None:
        """Start with no surface known."""
        self._stamp_ns = 0
        self._ranges = np.zeros(0)
        self._labels = np.zeros(0, dtype=np.int32)
        self.surfaces = 0                              # numbers given so far

    def segment(self, scan: Scan) -> Labels:
        """
        Cut the next scan into surfaces.

        Parameters
        ----------
        scan
            Any scan; rays that are not valid belong to no surface and end the one before.

        Returns
        -------
        Labels
            (n,) number of the surface each ray met, `UNLABELLED` for rays on none.

        """
        ranges = np.where(scan.valid, scan.ranges, np.nan)
        pieces = np.empty(len(scan), dtype=np.int32)
        _segment(ranges, scan.angles, pieces)
        if len(self._ranges) != len(ranges):
            self._ranges = np.full(len(ranges), np.nan)
            self._labels = np.full(len(ranges), UNLABELLED, dtype=np.int32)
        labels = np.empty(len(scan), dtype=np.int32)
        self.surfaces = _follow(
            ranges, pieces, self._ranges, self._labels,
            FAST * min(1e-9 * abs(scan.stamp_ns - self._stamp_ns), 0.2), self.surfaces, labels)
        self._stamp_ns = scan.stamp_ns
        self._ranges, self._labels = ranges, labels
        return labels


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
    return bool(abs(1.0 / inverse - r) < 0.5 * (STEP + STEP_PER_RANGE * r))


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _segment(ranges: Array, angles: Array, labels: Labels) -> None:
    n = len(ranges)
    label, start = 0, 0
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
        start = j + 1


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _follow(
    ranges: Array, pieces: Labels, ranges_before: Array, labels_before: Labels, moved: float,
    surfaces: int, labels: Labels,
) -> int:
    """Give the rays the numbers of the surfaces they continue; return how many are given."""
    n = len(ranges)
    labels[:] = UNLABELLED
    start = 0
    while start < n:
        end = start + 1
        while end < n and pieces[end] == pieces[start]:
            end += 1
        if pieces[start] != UNLABELLED:
            for j in range(start, end):
                labels[j] = _before(ranges[j], j, ranges_before, labels_before, moved)
            if not _fill(labels, start, end):
                labels[start:end] = surfaces
                surfaces += 1
        start = end
    return surfaces


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _before(
    r: float, j: int, ranges_before: Array, labels_before: Labels, moved: float,
) -> int:
    """Return the number of the surface that was met at a ray's bearing or beside it before."""
    for k in (j, j - 1, j + 1):
        if (0 <= k < len(labels_before) and labels_before[k] != UNLABELLED
                and abs(r - ranges_before[k]) < STEP + 0.02 * r + moved):
            return int(labels_before[k])
    return UNLABELLED


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _fill(labels: Labels, start: int, end: int) -> bool:
    """
    Give every ray of a piece a number, that of the nearest followed run; tell if there is one.

    Surfaces that touch for a moment stay apart by this, and take their own numbers with them when
    they part.  Numbers that only a ray or two have are strays at an edge.
    """
    longest = _strays(labels, start, end)
    if longest == 0:
        return False
    last = UNLABELLED
    for j in range(start, end):
        if labels[j] == UNLABELLED:
            labels[j] = last
        last = labels[j]
    for j in range(end - 1, start - 1, -1):
        if labels[j] == UNLABELLED:
            labels[j] = last
        last = labels[j]
    return True


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _strays(labels: Labels, start: int, end: int) -> int:
    """Remove the numbers of runs shorter than others by far; return the longest run."""
    longest, j = 0, start
    while j < end:
        k = j
        while k < end and labels[k] == labels[j]:
            k += 1
        if labels[j] != UNLABELLED:
            longest = max(longest, k - j)
        j = k
    j = start
    while j < end:
        k = j
        while k < end and labels[k] == labels[j]:
            k += 1
        if k - j < MIN_RAYS and k - j < longest:
            labels[j:k] = UNLABELLED
        j = k
    return longest
