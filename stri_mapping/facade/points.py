# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Points of the facades, and the rays that they are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Classes of points by their codes in LAS 1.4 (table 17); docs/facade.md says what each holds.
OTHER, GROUND, VEGETATION, FACADE, NOISE = 1, 2, 5, 6, 7
CLASS_NAMES = {OTHER: 'other', GROUND: 'ground', VEGETATION: 'vegetation', FACADE: 'facade',
               NOISE: 'noise or moving'}


@dataclass(frozen=True, eq=False)
class FacadePoints:
    """
    Points of the facades, one a ray that hit something.

    Attributes
    ----------
    xyz
        (n, 3) metres in odom; always finite.
    intensity
        (n,) float32 in the scanner's units; 0 where it gives none.
    stamps_ns
        (n,) int64 time of each ray in nanoseconds.
    ring
        (n,) uint16 index of the scanner among the vertical ones.
    label
        (n,) uint8 class of each point, a code of `CLASS_NAMES`.

    """

    xyz: Array
    intensity: NDArray[np.float32]
    stamps_ns: NDArray[np.int64]
    ring: NDArray[np.uint16]
    label: NDArray[np.uint8]

    def __len__(self) -> int:
        """Return the number of points, which may be 0."""
        return len(self.xyz)


def concatenate(pieces: Sequence[FacadePoints]) -> FacadePoints:
    """Return all points of some pieces, in order; none for no pieces."""
    if len(pieces) == 1:
        return pieces[0]
    return FacadePoints(
        np.concatenate([np.empty((0, 3)), *(p.xyz for p in pieces)]),
        np.concatenate([np.empty(0, np.float32), *(p.intensity for p in pieces)]),
        np.concatenate([np.empty(0, np.int64), *(p.stamps_ns for p in pieces)]),
        np.concatenate([np.empty(0, np.uint16), *(p.ring for p in pieces)]),
        np.concatenate([np.empty(0, np.uint8), *(p.label for p in pieces)]))


def chosen(points: FacadePoints, which: NDArray[np.bool_] | slice) -> FacadePoints:
    """Return some of the points: a slice of them, or those of a mask (n,)."""
    return FacadePoints(points.xyz[which], points.intensity[which], points.stamps_ns[which],
                        points.ring[which], points.label[which])


@dataclass(frozen=True, eq=False)
class Rays:
    """
    Rays that hit something and have a planar pose at their time, scan line by scan line.

    Attributes
    ----------
    base
        (n, 3) where each hit, metres in base_link.
    poses
        (n, 3) planar pose of base_link in odom at each ray's time: x, y, yaw.
    stamps_ns, intensity, ring
        (n,) as in `FacadePoints`.
    first
        (m + 1,) index of the first ray of each of the m lines, and n at the end.

    """

    base: Array
    poses: Array
    stamps_ns: NDArray[np.int64]
    intensity: NDArray[np.float32]
    ring: NDArray[np.uint16]
    first: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of rays, which may be 0."""
        return len(self.base)
