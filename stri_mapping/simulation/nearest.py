# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""How far points lie from the true surfaces: what a cloud of a virtual drive is judged by."""

from __future__ import annotations

import math
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData

Array = NDArray[np.float64]

# Edge of the cells in which triangles are looked up, metres.
CELL = 0.5


class Surfaces:
    """
    Triangles prepared for the question which of them is nearest to a point.

    Parameters
    ----------
    triangles
        (m, 3, 3) corners, metres.
    reach
        Metres; points farther than this from every triangle are told apart by NaN.

    """

    def __init__(self, triangles: Array, reach: float = 0.3) -> None:
        """Sort the triangles into cells."""
        self.reach = reach
        self._triangles = np.ascontiguousarray(triangles)
        low = triangles.reshape(-1, 3).min(axis=0) - reach - CELL
        high = triangles.reshape(-1, 3).max(axis=0) + reach + CELL
        self._low = low
        self._shape = np.ceil((high - low) / CELL).astype(np.int64)
        count = _cells(self._triangles, low, self._shape, reach, np.empty(0, np.int64),
                       np.empty(0, np.int32))
        keys, members = np.empty(count, np.int64), np.empty(count, np.int32)
        _cells(self._triangles, low, self._shape, reach, keys, members)
        order = np.argsort(keys, kind='stable')
        self._members = members[order]
        self._keys, self._first = np.unique(keys[order], return_index=True)
        self._first = np.append(self._first, count)

    def nearest(self, xyz: Array) -> Array:
        """
        Return the nearest surface point of each point.

        Parameters
        ----------
        xyz
            (n, 3) metres in odom.

        Returns
        -------
        Array
            (n, 3); NaN where nothing is within `reach`.

        """
        index = np.floor((xyz - self._low) / CELL).astype(np.int64)
        inside = np.all((index >= 0) & (index < self._shape), axis=1)
        key = (index[:, 0] * self._shape[1] + index[:, 1]) * self._shape[2] + index[:, 2]
        place = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        place[~inside | (self._keys[place] != key)] = -1
        return np.asarray(_nearest(np.ascontiguousarray(xyz), place, self._first, self._members,
                                   self._triangles, self.reach))


def read_surfaces(path: Path, reach: float = 0.3) -> Surfaces:
    """Read the surfaces.ply of a virtual drive, see `stri_mapping.simulation.record`."""
    content = PlyData.read(path)
    vertex = content['vertex']
    corners = np.stack([vertex['x'], vertex['y'], vertex['z']], axis=1)
    return Surfaces(corners[np.stack(content['face']['vertex_indices'])], reach)


@numba.njit(cache=True)
def _cells(  # type: ignore[no-untyped-def]
    triangles, low, shape, reach, keys, members,
):
    """Write every (cell, triangle) that may be within reach; return how many; only count if 0."""
    count = 0
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    slack = 0.5 * math.sqrt(3.0) * CELL + reach
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        normal = np.cross(b - a, c - a)
        normal /= math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        for m in range(3):
            first[m] = int((min(a[m], b[m], c[m]) - reach - low[m]) / CELL)
            last[m] = int((max(a[m], b[m], c[m]) + reach - low[m]) / CELL)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    away = (normal[0] * (low[0] + (i + 0.5) * CELL - a[0])
                            + normal[1] * (low[1] + (j + 0.5) * CELL - a[1])
                            + normal[2] * (low[2] + (k + 0.5) * CELL - a[2]))
                    if abs(away) > slack:
                        continue
                    if len(keys):
                        keys[count] = (i * shape[1] + j) * shape[2] + k
                        members[count] = t
                    count += 1
    return count


@numba.njit(cache=True)
def _nearest(  # type: ignore[no-untyped-def]
    xyz, place, first, members, triangles, reach,
):
    out = np.full(xyz.shape, np.nan)
    for i in range(len(xyz)):
        if place[i] < 0:
            continue
        best = reach * reach
        for q in range(first[place[i]], first[place[i] + 1]):
            t = triangles[members[q]]
            p = _closest(xyz[i], t[0], t[1], t[2])
            square = ((p[0] - xyz[i, 0]) ** 2 + (p[1] - xyz[i, 1]) ** 2
                      + (p[2] - xyz[i, 2]) ** 2)
            if square < best:
                best = square
                out[i] = p
    return out


@numba.njit(cache=True)
def _closest(p, a, b, c):  # type: ignore[no-untyped-def]
    """Return the point of a triangle nearest to p (Ericson, Real-Time Collision Detection 5.1)."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return a
    bp = p - b
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return b
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return a + ab * (d1 / (d1 - d3))
    cp = p - c
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return c
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return a + ac * (d2 / (d2 - d6))
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    total = va + vb + vc
    return a + ab * (vb / total) + ac * (vc / total)


@numba.njit(cache=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
