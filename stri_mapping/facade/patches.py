# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Small planes of walls, as each scanner has seen them, and how far others' points are off."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.angles import heading
from stri_mapping.facade.points import FACADE, OTHER

Array = NDArray[np.float64]

# Edge of a patch, metres.
CUBE = 0.5
# Of the points every other one is kept.  Patches kept, a power of two: a minute of street.
SLOTS = 1 << 17
# A patch is used with so many points, this thin and this wide at least, metres, if it is upright
# and was seen so long before, seconds, and not longer ago.
ENOUGH, THIN, WIDE, UPRIGHT, BEFORE, FORGET = 6, 0.025, 0.08, 0.3, 0.3, 15.0
# Lowest point that is used, metres: above kerbs.
LOW = 0.4
# One point in so many is compared.  Its deviation, metres, stands for what all those of a patch
# have in common: bias, footprint, plaster.
EVERY, DEVIATION = 3, 0.06
# A point this far off a patch counts a quarter, metres, and nothing beyond the reach.
SCALE, REACH = 0.03, 0.15
# Columns of the statistics: count, sums of x y z, of their products, and of the time.
COUNT, SUM, PRODUCT, TIME, LAST, STATISTICS = 0, 1, 4, 10, 11, 12
# Columns of the planes: points at the last fit, normal, distance.
FITTED, NORMAL, DISTANCE, PLANE = 0, 1, 4, 5


class Patches:
    """
    Remembers patches by cube and scanner, in a table of fixed size.

    Parameters
    ----------
    rings
        Number of scanners.

    """

    def __init__(self, rings: int) -> None:
        """Begin with nothing seen."""
        self._rings = rings
        self._keys = np.full(SLOTS, -1, np.int64)
        self._statistics = np.zeros((SLOTS, STATISTICS))
        self._planes = np.zeros((SLOTS, PLANE))

    def add(self, xyz: Array, stamps_ns: NDArray[np.int64], ring: NDArray[np.uint16],
            label: NDArray[np.uint8]) -> None:
        """Take points (n, 3) in odom, seen at times (n,), into the patches."""
        _add(xyz, stamps_ns, ring, label, self._keys, self._statistics)

    def compare(self, xyz: Array, poses: Array, stamps_ns: NDArray[np.int64],
                ring: NDArray[np.uint16], label: NDArray[np.uint8], start_ns: int, knot_ns: int,
                knots: Array) -> tuple[Array, Array]:
        """
        Return how points would have to move to lie in the patches of other scanners.

        Parameters
        ----------
        xyz, poses, stamps_ns, ring, label
            (n, 3) points in odom, (n, 3) poses x, y, yaw of the vehicle, (n,) the rest.
        start_ns, knot_ns
            Time of the first of two knots, and to the second.
        knots
            (2, 2) the correction expected at either: metres to the left, radians.

        Returns
        -------
        information, vector : Array
            (4, 4) and (4,) normal equations of the two knots.

        """
        information, vector = np.zeros((4, 4)), np.zeros(4)
        _compare(xyz, poses, stamps_ns, ring, label, start_ns, knot_ns, knots, self._rings,
                 self._keys, self._statistics, self._planes, information, vector)
        return information, vector


@numba.njit(cache=True, inline='always')
def _key(x, y, z, ring):  # type: ignore[no-untyped-def]
    return (((int(math.floor(x / CUBE)) & 0xFFFFF) << 32)
            | ((int(math.floor(y / CUBE)) & 0xFFFFF) << 12)
            | ((int(math.floor(z / CUBE)) & 0xFF) << 4) | (ring & 0xF))


@numba.njit(cache=True, inline='always')
def _inside(x):  # type: ignore[no-untyped-def]
    """Return a coordinate from the cube's corner: small numbers keep their digits."""
    return x - CUBE * math.floor(x / CUBE)


@numba.njit(cache=True, inline='always')
def _home(key):  # type: ignore[no-untyped-def]
    """Return the slot where a key is looked for first."""
    mixed = key * 0x9E3779B97F4A7C1 & 0x7FFFFFFFFFFFFFF
    return (mixed >> 20) & (SLOTS - 1)


@numba.njit(cache=True)
def _find(key, keys):  # type: ignore[no-untyped-def]
    """Return the slot of a key, or -1."""
    home = _home(key)
    for i in range(4):
        if keys[(home + i) & (SLOTS - 1)] == key:
            return (home + i) & (SLOTS - 1)
    return -1


@numba.njit(cache=True)
def _claim(key, keys, statistics):  # type: ignore[no-untyped-def]
    """Return an empty slot for a key; where all are taken, that of the patch seen longest ago."""
    home, oldest = _home(key), -1
    for i in range(4):
        slot = (home + i) & (SLOTS - 1)
        if keys[slot] < 0:
            oldest = slot
            break
        if oldest < 0 or statistics[slot, LAST] < statistics[oldest, LAST]:
            oldest = slot
    keys[oldest] = key
    statistics[oldest] = 0.0
    return oldest


@numba.njit(cache=True)
def _add(xyz, stamps, ring, label, keys, statistics):  # type: ignore[no-untyped-def]
    last, slot = -1, -1
    for i in range(0, len(xyz), 2):
        if xyz[i, 2] < LOW or (label[i] != FACADE and label[i] != OTHER):
            continue
        key, seconds = _key(xyz[i, 0], xyz[i, 1], xyz[i, 2], ring[i]), 1e-9 * stamps[i]
        if key != last:                          # neighbours mostly share their cube
            slot, last = _find(key, keys), key
        if slot < 0 or seconds - statistics[slot, LAST] > FORGET:
            slot = _claim(key, keys, statistics) if slot < 0 else slot
            statistics[slot] = 0.0
        row = statistics[slot]
        row[COUNT] += 1.0
        row[TIME] += seconds
        row[LAST] = seconds
        x, y, z = _inside(xyz[i, 0]), _inside(xyz[i, 1]), _inside(xyz[i, 2])
        row[SUM] += x
        row[SUM + 1] += y
        row[SUM + 2] += z
        row[PRODUCT] += x * x
        row[PRODUCT + 1] += y * x
        row[PRODUCT + 2] += y * y
        row[PRODUCT + 3] += z * x
        row[PRODUCT + 4] += z * y
        row[PRODUCT + 5] += z * z


@numba.njit(cache=True)
def _fit(row, plane):  # type: ignore[no-untyped-def]
    """Write the plane through a patch's points; its normal is zero where they form none."""
    n, k = row[COUNT], PRODUCT
    covariance = np.empty((3, 3))
    for m in range(3):
        for q in range(m + 1):
            covariance[m, q] = row[k] / n - row[SUM + m] * row[SUM + q] / n**2
            covariance[q, m] = covariance[m, q]
            k += 1
    variance, axes = np.linalg.eigh(covariance)
    plane[:] = 0.0
    plane[FITTED] = n
    if variance[0] < THIN**2 and variance[1] > WIDE**2 and abs(axes[2, 0]) < UPRIGHT:
        for m in range(3):
            plane[NORMAL + m] = axes[m, 0]
            plane[DISTANCE] += axes[m, 0] * row[SUM + m] / n


@numba.njit(cache=True)
def _compare(  # type: ignore[no-untyped-def]
    xyz, poses, stamps, ring, label, start, spacing, knots, rings, keys, statistics, planes,
    information, vector,
):
    row, known = np.empty(4), np.full(3, np.nan)
    for i in range(0, len(xyz), EVERY):
        if xyz[i, 2] < LOW or (label[i] != FACADE and label[i] != OTHER):
            continue
        for other in range(rings):
            if other == ring[i]:
                continue
            slot = _find(_key(xyz[i, 0], xyz[i, 1], xyz[i, 2], other), keys)
            if slot < 0 or statistics[slot, COUNT] < ENOUGH:
                continue
            ago = 1e-9 * stamps[i] - statistics[slot, TIME] / statistics[slot, COUNT]
            if ago < BEFORE or ago > FORGET:
                continue
            plane = planes[slot]
            if plane[FITTED] != statistics[slot, COUNT]:
                _fit(statistics[slot], plane)
            off = -plane[DISTANCE]
            for m in range(3):
                off += plane[NORMAL + m] * _inside(xyz[i, m])
            cos, sin = heading(poses[i, 2], known)
            left = plane[NORMAL + 1] * cos - plane[NORMAL] * sin
            turn = (plane[NORMAL + 1] * (xyz[i, 0] - poses[i, 0])
                    - plane[NORMAL] * (xyz[i, 1] - poses[i, 1]))
            f = min((stamps[i] - start) / spacing, 1.0)
            row[0], row[1], row[2], row[3] = (1.0 - f) * left, (1.0 - f) * turn, f * left, f * turn
            rest = off + row[0] * knots[0, 0] + row[1] * knots[0, 1] + (
                row[2] * knots[1, 0] + row[3] * knots[1, 1])
            if abs(rest) > REACH:
                continue
            weight = (1.0 + (rest / SCALE) ** 2) ** -2 / DEVIATION**2
            for a in range(4):
                vector[a] -= weight * row[a] * off
                for b in range(4):
                    information[a, b] += weight * row[a] * row[b]
