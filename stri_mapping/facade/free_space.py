# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
What moves: things that stand where rays went through before.

The street is a grid seen from above.  A ray leaves the cells free that it crosses at the height
of a car's body.  A hit in a cell that several rays found free, and hardly any occupied, is that
of something that came: a vehicle, a person.  Only the past is asked, so that the answer does not
depend on how much of the drive is known already.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.angles import heading
from stri_mapping.facade.points import Rays

Array = NDArray[np.float64]

# Edge of a cell, metres, and cells along each side of the grid, a power of two: it wraps around.
CELL, SIZE = 0.25, 1024
# Heights between which a ray tells of free space, metres: above kerbs, below a bonnet.
LOW, HIGH = 0.3, 1.0
# A ray's last metres before its hit tell nothing: ranges and poses are not exact.
MARGIN = 0.5
# Rays that must have found a cell free, and how many more than found it occupied.
ENOUGH, RATIO = 3, 2
# Heights up to which a hit is judged by its cell, metres; higher ones go by those below them
# in the last so many nanoseconds.
TALL, ABOVE_NS = 2.0, 100_000_000
# Cells not looked at for so long are forgotten, nanoseconds: before a vehicle at 90 km/h comes to
# the same cell again, a whole grid further.
FORGET_NS = 10_000_000_000


class FreeSpace:
    """
    Remembers where rays went through.

    Parameters
    ----------
    origins
        (r, 3) of the scanners in base_link, metres.

    """

    def __init__(self, origins: Array) -> None:
        """Begin with nothing known."""
        self._origins = np.ascontiguousarray(origins)
        self._free = np.zeros(SIZE * SIZE, np.uint16)
        self._hits = np.zeros(SIZE * SIZE, np.uint16)
        self._seen_ns = np.full(SIZE * SIZE, -(1 << 62), np.int64)
        self._moved_ns = self._seen_ns.copy()
        self._latest_ns = self._moved_ns[:1].copy()         # of all cells

    def moving(self, rays: Rays) -> NDArray[np.bool_]:
        """Take the next rays; return which (n,) hit something that was not there before."""
        return np.asarray(_moving(rays.base, rays.poses, rays.stamps_ns, rays.ring,
                                  rays.first, self._origins, self._free, self._hits, self._seen_ns,
                                  self._moved_ns, self._latest_ns))


@numba.njit(cache=True)
def _moving(  # type: ignore[no-untyped-def]
    base, poses, stamps, ring, first, origins, free, hits, seen, moved, latest,
):
    found, known = np.zeros(len(base), np.bool_), np.full(3, np.nan)
    line = 0
    for i in range(len(base)):
        while i >= first[line + 1]:
            line += 1
        z, top = base[i, 2], origins[ring[i], 2]
        if z > TALL and stamps[i] - latest[0] > ABOVE_NS:
            continue
        cos, sin = heading(poses[i, 2], known)
        x = poses[i, 0] + cos * base[i, 0] - sin * base[i, 1]
        y = poses[i, 1] + sin * base[i, 0] + cos * base[i, 1]
        if z > LOW:
            cell = _cell(x / CELL, y / CELL)
            if z > TALL:
                # what is above a thing that moves is part of it; else a balcony, or leaves
                found[i] = stamps[i] - moved[cell] < ABOVE_NS
            elif _was_free(free, hits, seen, cell, stamps[i]):
                found[i], moved[cell], latest[0] = True, stamps[i], stamps[i]
            else:
                _count(hits, free, seen, cell, stamps[i])
        # every other ray of a line is enough to tell that cells are free
        if z >= HIGH or top <= HIGH or (i - first[line]) % 2:
            continue
        dx = base[i, 0] - origins[ring[i], 0]
        dy = base[i, 1] - origins[ring[i], 1]
        out = math.sqrt(dx * dx + dy * dy)
        # the part of the ray, as shares of its horizontal length, between the two heights
        begin = (top - HIGH) / (top - z)
        end = min((top - LOW) / (top - z), 1.0 - MARGIN / max(out, MARGIN))
        steps = int((end - begin) * out / CELL) + 1
        if end <= begin:
            continue
        # in cells, from the middle of the first step
        ahead, left = (cos * dx - sin * dy) / CELL, (sin * dx + cos * dy) / CELL
        step, stamp, last = (end - begin) / steps, stamps[i], -1
        back = 1.0 - begin - 0.5 * step
        p, q = x / CELL - back * ahead, y / CELL - back * left
        ahead, left = step * ahead, step * left
        for k in range(steps):
            cell = _cell(p + k * ahead, q + k * left)
            if cell != last:
                _count(free, hits, seen, cell, stamp)
                last = cell
    return found


@numba.njit(cache=True, inline='always')
def _cell(p, q):  # type: ignore[no-untyped-def]
    """Return the number of the cell at a place in cells; the grid wraps around."""
    return ((int(math.floor(p)) & (SIZE - 1)) * SIZE) + (int(math.floor(q)) & (SIZE - 1))


@numba.njit(cache=True)
def _was_free(free, hits, seen, cell, stamp):  # type: ignore[no-untyped-def]
    """
    Return whether a cell was free, and the eight around it too.

    Cells at the edge of what stands still are half free; what moves comes to open street.
    """
    a, b, total = cell // SIZE, cell % SIZE, 0
    for i in range(-1, 2):
        for j in range(-1, 2):
            near = ((a + i) & (SIZE - 1)) * SIZE + ((b + j) & (SIZE - 1))
            total += hits[near]
            if free[near] < ENOUGH or stamp - seen[near] > FORGET_NS:
                return False
    return free[cell] > RATIO * total


@numba.njit(cache=True, inline='always')
def _count(one, other, seen, cell, stamp):  # type: ignore[no-untyped-def]
    """Add to a cell's count; a cell not seen for long begins anew."""
    if stamp - seen[cell] > FORGET_NS:
        one[cell], other[cell] = 0, 0
    if one[cell] < 60000:
        one[cell] += 1
    seen[cell] = stamp
