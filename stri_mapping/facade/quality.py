# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
How good a cloud is, told by itself: whether surfaces that ought to be thin come out thin.

Space is cut into cubes.  In each cube whose points lie about a plane, the plane is fitted to all
of them; what the scanners saw at different times must then fall on it together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Edge of a cube, metres: large against the noise, small against what is built on facades.
CUBE = 0.6
# Height of the boxes in which walls are held against the upright, metres.
TALL = 2.4
# Points that a scanner must have in a cube to be compared there.
ENOUGH = 8
# A cube holds one plane if its points stay this near to it and reach this far along it, metres.
# Thicker ones than this hold edges and reveals, or a surface that is mapped twice.
THICK, WIDE = 0.12, 0.12
# Surfaces of two scanners further apart than this show as a doubled edge, metres.
DOUBLED = 0.04


@dataclass(frozen=True)
class CloudQuality:
    """
    Figures of a cloud; NaN where no cube told.

    Attributes
    ----------
    cubes
        Cubes with one plane seen by at least two scanners.
    thickness_mm
        Root mean square distance of a cube's points from its plane, median over the cubes.
    agreement_mm
        Root mean square distance of the scanners' own planes' middles from each other.
    doubled
        Share of the cubes in which two scanners' surfaces are more than 4 cm apart.
    lean_deg
        Angle of the walls' planes from upright in boxes 2.4 m high, median of its absolute.

    """

    cubes: int
    thickness_mm: float
    agreement_mm: float
    doubled: float
    lean_deg: float


def measure(xyz: Array, ring: NDArray[np.integer]) -> CloudQuality:
    """
    Return the quality of points (n, 3) of several scanners, by ring (n,).

    The ground and other level surfaces do not count.
    """
    cubes = _Cubes(xyz, ring, CUBE)
    spread, widest = cubes.between_rings()
    tall = _Cubes(xyz, ring, TALL)
    if not len(spread) or not tall.walls.any():
        return CloudQuality(len(spread), np.nan, np.nan, np.nan, np.nan)
    lean = np.arcsin(np.clip(np.abs(tall.normal[tall.walls, 2]), 0.0, 1.0))
    return CloudQuality(
        len(spread), 1e3 * float(np.median(cubes.thickness[cubes.walls])),
        1e3 * float(np.sqrt(np.mean(spread))), float(np.mean(widest > DOUBLED)),
        float(np.rad2deg(np.median(lean))))


class _Cubes:
    """Moments of the points of every cube, whole and by scanner."""

    def __init__(self, xyz: Array, ring: NDArray[np.integer], height: float) -> None:
        edges = np.array([CUBE, CUBE, height])
        index = np.floor(xyz / edges).astype(np.int64)
        index -= index.min(axis=0, initial=0)
        shape = index.max(axis=0, initial=0) + 1
        keys = (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
        _, cube = np.unique(keys, return_inverse=True)
        total = int(cube.max(initial=-1)) + 1
        self.count = np.bincount(cube, minlength=total)
        inside = xyz - edges * np.floor(xyz / edges)    # small numbers keep their digits
        self.mean = _sums(cube, inside, total) / self.count[:, None]
        off = inside - self.mean[cube]
        covariance = np.empty((total, 3, 3))
        for i in range(3):
            for j in range(i + 1):
                covariance[:, i, j] = covariance[:, j, i] = np.bincount(
                    cube, off[:, i] * off[:, j], total) / self.count
        variance, axes = np.linalg.eigh(covariance)
        self.thickness = np.sqrt(np.maximum(variance[:, 0], 0.0))
        self.normal = axes[:, :, 0]
        self.walls = ((self.count >= 2 * ENOUGH) & (self.thickness < THICK)
                      & (variance[:, 1] > WIDE**2) & (variance[:, 0] < 0.3 * variance[:, 1])
                      & (np.abs(self.normal[:, 2]) < 0.3))
        self._cube, self._ring = cube, ring
        self._along = np.sum(off * self.normal[cube], axis=1)

    def between_rings(self) -> tuple[Array, Array]:
        """Return, of the walls seen by two, the variance between rings and the widest gap."""
        total, rings = len(self.count), int(self._ring.max(initial=0)) + 1
        count, middle = np.zeros((total, rings)), np.full((total, rings), np.nan)
        for r in range(rings):
            own = self._ring == r
            count[:, r] = np.bincount(self._cube[own], minlength=total)
            seen = count[:, r] >= ENOUGH
            middle[seen, r] = np.bincount(
                self._cube[own], self._along[own], total)[seen] / count[seen, r]
        both = self.walls & (np.sum(np.isfinite(middle), axis=1) >= 2)
        gap = np.nanmax(middle[both], axis=1) - np.nanmin(middle[both], axis=1) if (
            both.any()) else np.empty(0)
        return np.nanvar(middle[both], axis=1) if both.any() else np.empty(0), gap


def _sums(group: NDArray[np.intp], values: Array, total: int) -> Array:
    return np.stack([np.bincount(group, column, total) for column in values.T], axis=1)
