# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Ghosts: points that hang between two surfaces, because their ray hit both.

A beam is some 15 cm wide at a facade.  At the side of a window part of it goes in: the range is
somewhere between wall and pane.  Along the scan line such a point stands alone between two even
stretches; at upright edges a whole line of them stands alone between the lines before and after.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.points import GROUND, NOISE, Rays
from stri_mapping.facade.survey import scan_plane
from stri_mapping.vehicle import Scanner

Array = NDArray[np.float64]

# A ghost is further than this from either surface, metres: four deviations of the range noise.
AWAY = 0.04
# Two neighbours are one surface if they differ by less than that, or than this share of their
# distance from the point: what rises step by step is a slope.
EVEN = 0.35
# A line is compared with those this far before and behind it along the way, metres: nearer ones
# have the same edge in their beams.
STEP = 0.06
# Lines wait this long at most for those after them, nanoseconds.  Their points become final later.
PATIENCE_NS = 250_000_000
# Rays of two lines at the same elevation differ by less than this, radians: interlaced turns are
# half a degree apart.
SAME = math.radians(0.55)
# Lines kept of each scanner: those of half a second and more, at 75 Hz.
KEPT = 64
LINE = np.dtype([('stamp_ns', np.int64), ('first', np.int64), ('count', np.int64),
                 ('x', np.float64), ('y', np.float64), ('way', np.float64)])


class GhostFinder:
    """
    Marks ghosts as noise, each line when those after it have come.

    The same lines give the same ghosts however they are cut into batches.

    Parameters
    ----------
    scanners
        The vertical scanners.

    """

    def __init__(self, scanners: Sequence[Scanner]) -> None:
        """Begin without lines."""
        self._planes = np.array([scan_plane(s.T_base_laser) for s in scanners]).reshape(-1, 3, 3)
        self._lines = np.zeros((len(scanners), KEPT), LINE)
        self._counts = np.zeros((len(scanners), 2), np.int64)    # lines that came, and judged
        self._points = np.zeros((2, len(scanners), KEPT, 0))     # elevation, distance
        # classes of the last lines, with the number of their first point and their newest stamp
        self._labels: list[tuple[int, int, NDArray[np.uint8]]] = []
        self._total = 0

    def mark(self, rays: Rays, label: NDArray[np.uint8]) -> None:
        """
        Take the next lines and mark what can be told.

        Parameters
        ----------
        rays
            Their points.
        label
            (n,) classes, set to `NOISE` for ghosts: now, or with a later call.

        """
        more = int(np.diff(rays.first).max(initial=0)) - self._points.shape[3]
        if more > 0:
            self._points = np.pad(self._points, ((0, 0), (0, 0), (0, 0), (0, more)))
        ghosts = _find(rays.base, rays.poses, rays.stamps_ns, rays.ring, rays.first, label,
                       self._planes, self._lines, self._counts, self._points[0], self._points[1],
                       self._total)
        newest = int(rays.stamps_ns.max(initial=0))
        # a line and the second one after it are two patiences apart at most
        self._labels = [each for each in self._labels if each[1] > newest - 4 * PATIENCE_NS]
        self._labels.append((self._total, newest, label))
        self._total += len(label)
        for begin, _, each in self._labels:
            each[ghosts[(ghosts >= begin) & (ghosts < begin + len(each))] - begin] = NOISE


@numba.njit(cache=True)
def _find(  # type: ignore[no-untyped-def]
    base, poses, stamps, ring, first, label, planes, lines, counts, elevations, depths, total,
):
    """Take some lines; return the numbers of the points, in all, that turn out as ghosts."""
    found = []
    for q in range(len(first) - 1):
        begin, n = first[q], first[q + 1] - first[q]
        if n == 0:
            continue
        r = ring[begin]
        new, before = lines[r, counts[r, 0] % KEPT], lines[r, (counts[r, 0] - 1) % KEPT]
        elevation = elevations[r, counts[r, 0] % KEPT]
        depth = depths[r, counts[r, 0] % KEPT]
        _in_plane(base[begin:begin + n], label[begin:begin + n], planes[r], elevation, depth)
        new.way = before.way + math.hypot(poses[begin, 0] - before.x, poses[begin, 1] - before.y)
        new.x, new.y, new.stamp_ns = poses[begin, 0], poses[begin, 1], stamps[begin]
        new.first, new.count = total + begin, n
        for i in range(2, n - 2):
            if _hangs(depth[i - 2], depth[i - 1], depth[i], depth[i + 1], depth[i + 2]):
                found.append(new.first + i)
        counts[r, 0] += 1
        _judge(lines[r], counts[r], elevations[r], depths[r], found)
    return np.array(found, dtype=np.int64)


@numba.njit(cache=True)
def _in_plane(base, label, plane, elevation, depth):  # type: ignore[no-untyped-def]
    """Write tangent of elevation, and distance aside, from the scanner; NaN for the ground's."""
    for i in range(len(base)):
        t, v = 0.0, 0.0
        for m in range(3):
            t += (base[i, m] - plane[0, m]) * plane[1, m]
            v += (base[i, m] - plane[0, m]) * plane[2, m]
        elevation[i], depth[i] = v / max(t, 1e-3), np.nan if label[i] == GROUND else t


@numba.njit(cache=True)
def _judge(lines, counts, elevations, depths, found):  # type: ignore[no-untyped-def]
    """Compare the lines that have not been, and for which those after them have come."""
    newest = counts[0] - 1
    while counts[1] <= newest:
        k = counts[1]
        before, after = _step(lines, counts, k, -1), _step(lines, counts, k, 1)
        outer = _step(lines, counts, before, -1) if before >= 0 else -1
        beyond = _step(lines, counts, after, 1) if after >= 0 else -1
        if outer >= 0 and beyond >= 0:
            _compare(lines, elevations, depths, k, (outer, before, after, beyond), found)
        elif (lines[newest % KEPT].stamp_ns - lines[k % KEPT].stamp_ns < PATIENCE_NS
              and newest - k < KEPT // 2):
            return
        counts[1] += 1


@numba.njit(cache=True)
def _step(lines, counts, k, sign):  # type: ignore[no-untyped-def]
    """Return the number of the nearest line a step before or behind line k, or -1."""
    here = lines[k % KEPT]
    i = k + sign
    while max(counts[0] - KEPT, 0) <= i < counts[0]:
        line = lines[i % KEPT]
        if abs(line.stamp_ns - here.stamp_ns) > PATIENCE_NS:
            return -1
        if abs(line.way - here.way) >= STEP:
            return i
        i += sign
    return -1


@numba.njit(cache=True)
def _compare(lines, elevations, depths, k, others, found):  # type: ignore[no-untyped-def]
    """Find the points of line k that hang between the two lines before and the two after it."""
    count, depth = lines[k % KEPT].count, depths[k % KEPT]
    near = np.empty((4, count))
    for m in range(4):
        slot = others[m] % KEPT
        _beside(elevations[k % KEPT, :count], elevations[slot, :lines[slot].count], depths[slot],
                near[m])
    for i in range(count):
        if _hangs(near[0, i], near[1, i], depth[i], near[2, i], near[3, i]):
            found.append(lines[k % KEPT].first + i)


@numba.njit(cache=True)
def _beside(elevation, other, depth, near):  # type: ignore[no-untyped-def]
    """Write the depth of another line's ray beside each of a line's; NaN where there is none."""
    j, last = 0, len(other) - 1
    for i in range(len(elevation)):
        here = elevation[i]
        off = abs(other[j] - here)
        # both rise, or both fall, along their lines
        while j < last:
            further = abs(other[j + 1] - here)
            if not further <= off:
                break
            j, off = j + 1, further
        near[i] = depth[j] if off < SAME * (1.0 + here * here) else np.nan


@numba.njit(cache=True, inline='always')
def _hangs(outer, before, depth, after, beyond):  # type: ignore[no-untyped-def]
    """Return whether a depth lies between two even stretches; never where one is NaN."""
    back, on = depth - before, after - depth
    return (back * on > 0.0 and min(abs(back), abs(on)) > AWAY
            and abs(before - outer) < max(AWAY, EVEN * abs(back))
            and abs(after - beyond) < max(AWAY, EVEN * abs(on)))
