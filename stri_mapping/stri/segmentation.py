# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Step 2 of the paper: surfaces in space and time.

A scan is cut where neighbouring rays do not continue one another.  Along a flat face 1/r is
linear in (cos, sin) of the bearing, so a face seen at grazing incidence continues although its
range runs away from ray to ray; a jump in depth does not.  A piece that lies over the same rays
at about the same range as one of the scan before is the same surface, a moment later.
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


class Segmenter:
    """Cuts scan after scan into surfaces that keep their number while they are in view."""

    def __init__(self) -> None:
        """Start with no surface known."""
        self._ranges = np.zeros(0)
        self._labels = np.zeros(0, dtype=np.int32)
        self.surfaces = 0                              # numbers given so far
        self.parents = np.zeros(0, dtype=np.int32)     # of the newest scan's new surfaces

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
            (n,) number of the surface each ray met, `UNLABELLED` for rays on none.  What splits
            off a surface gets a number of its own; `parent` tells which surface it came from.

        """
        ranges = np.where(scan.valid, scan.ranges, np.nan)
        pieces = np.empty(len(scan), dtype=np.int32)
        _segment(ranges, scan.angles, pieces)
        if len(self._ranges) != len(ranges):
            self._ranges = np.full(len(ranges), np.nan)
            self._labels = np.full(len(ranges), UNLABELLED, dtype=np.int32)
        labels = np.empty(len(scan), dtype=np.int32)
        parents = np.full(len(scan), UNLABELLED, dtype=np.int32)
        known = self.surfaces
        self.surfaces = _follow(ranges, pieces, self._ranges, self._labels, known, labels,
                                parents)
        self.parents = parents[:self.surfaces - known]
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
    ranges: Array, pieces: Labels, ranges_before: Array, labels_before: Labels, surfaces: int,
    labels: Labels, parents: Labels,
) -> int:
    """Give pieces the numbers of the surfaces they continue; return how many are given."""
    n, known = len(ranges), surfaces
    labels[:] = UNLABELLED
    start = 0
    while start < n:
        end = start + 1
        while end < n and pieces[end] == pieces[start]:
            end += 1
        if pieces[start] != UNLABELLED:
            best, most, votes, longest, parent = surfaces, 0, 0, 0, np.int32(UNLABELLED)
            for j in range(start, end):
                if (labels_before[j] == UNLABELLED
                        or abs(ranges[j] - ranges_before[j]) > 3.0 * STEP + 0.05 * ranges[j]):
                    continue
                votes = votes + 1 if labels_before[j] == labels_before[j - 1] else 1
                if votes > longest:
                    parent, longest = labels_before[j], votes
                if votes > most and not _taken(labels, labels_before[j]):
                    best, most = labels_before[j], votes
            labels[start:end] = best
            if best == surfaces:
                parents[surfaces - known] = parent if longest > 0 else UNLABELLED
                surfaces += 1
        start = end
    return surfaces


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _taken(labels: Labels, label: int) -> bool:
    for value in labels:
        if value == label:
            return True
    return False
