# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A thinned copy of the facades that stays small enough to look at live."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Points kept: a message of 2.4 MB, some 300 m of street at the default voxel.
LIMIT = 200_000
# Range of a voxel's index along an axis: +-2^20 voxels, 200 km at the default size.
INDEX_BITS = 21


class Overview:
    """
    The first point of every voxel.

    Parameters
    ----------
    voxel
        Edge length in metres.
    limit
        Points at most: where there would be more, voxels are doubled in edge length.

    """

    def __init__(self, voxel: float = 0.2, limit: int = LIMIT) -> None:
        """Start empty."""
        self._voxel, self._limit = voxel, limit
        self._seen: set[int] = set()
        self._pieces: list[Array] = []

    def __len__(self) -> int:
        """Return the number of points kept."""
        return len(self._seen)

    def add(self, xyz: Array) -> None:
        """Take points (n, 3) in metres, all finite; those of voxels seen before are dropped."""
        index = np.floor(xyz / self._voxel).astype(np.int64) & ((1 << INDEX_BITS) - 1)
        keys = (index[:, 0] << 2 * INDEX_BITS) | (index[:, 1] << INDEX_BITS) | index[:, 2]
        unique, first = np.unique(keys, return_index=True)
        new = np.array([key not in self._seen for key in unique.tolist()], dtype=bool)
        self._seen.update(unique[new].tolist())
        if new.any():
            self._pieces.append(xyz[np.sort(first[new])])
        if len(self._seen) > self._limit:
            kept = self.points()
            self._voxel *= 2.0
            self._seen, self._pieces = set(), []
            self.add(kept)

    def points(self) -> Array:
        """Return the points kept (m, 3), in the order they came."""
        if len(self._pieces) > 1:
            self._pieces = [np.concatenate(self._pieces)]
        return self._pieces[0] if self._pieces else np.empty((0, 3))
