# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Facade clouds as images: unrolled along the path, and seen from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from stri_mapping.trajectory import Trajectory

Array = NDArray[np.float64]

# Spacing of the path points that facade points are measured from, metres.
PATH_STEP = 0.2


@dataclass(frozen=True, eq=False)
class Unrolled:
    """
    Points measured from the path they were seen from.

    Attributes
    ----------
    along
        (n,) metres driven at the nearest point of the path.
    left
        (n,) metres to the left of the vehicle; negative on its right.
    up
        (n,) height in odom, metres.
    value
        (n,) what the points are coloured by.

    """

    along: Array
    left: Array
    up: Array
    value: Array

    def only(self, mask: NDArray[np.bool_]) -> Unrolled:
        """Return the points of a mask (n,)."""
        return Unrolled(self.along[mask], self.left[mask], self.up[mask], self.value[mask])


def unroll(xyz: Array, value: Array, path: Trajectory) -> Unrolled:
    """
    Return points (n, 3) by their place along and beside a path of at least one pose.

    On the inside of a bend several places of the path are about equally near, so that facades
    there may break; straight ones keep their shape.
    """
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.poses[:, :2], axis=0).T))])
    _, index = np.unique(np.floor(driven / PATH_STEP), return_index=True)
    poses, start = path.poses[index], driven[index]
    _, nearest = cKDTree(poses[:, :2]).query(xyz[:, :2])
    forward = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    # a vehicle that drives backwards gets on along its path towards its own rear
    moved = np.gradient(poses[:, :2], axis=0) if len(poses) > 1 else forward
    direction = np.where(np.sum(moved * forward, axis=1) < 0.0, -1.0, 1.0)
    offset = xyz[:, :2] - poses[nearest, :2]
    forward = forward[nearest]
    along = start[nearest] + direction[nearest] * np.sum(offset * forward, axis=1)
    left = forward[:, 0] * offset[:, 1] - forward[:, 1] * offset[:, 0]
    return Unrolled(along, left, xyz[:, 2], value)


@dataclass(frozen=True)
class Grid:
    """Pixels over a rectangle: its left, right, bottom and top, and the edge of a pixel."""

    left: float
    right: float
    bottom: float
    top: float
    cell: float

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """The rectangle as matplotlib wants it."""
        return self.left, self.right, self.bottom, self.top

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns; the first row is at the bottom."""
        return (max(int(np.ceil((self.top - self.bottom) / self.cell)), 1),
                max(int(np.ceil((self.right - self.left) / self.cell)), 1))

    def pixels(self, x: Array, y: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return which points (n,) lie inside, as indices (m,), and their pixels (m,)."""
        inside = np.flatnonzero((self.left <= x) & (x < self.right)
                                & (self.bottom <= y) & (y < self.top))
        rows, columns = self.shape
        row = np.minimum(((y[inside] - self.bottom) / self.cell).astype(int), rows - 1)
        column = np.minimum(((x[inside] - self.left) / self.cell).astype(int), columns - 1)
        return inside, row * columns + column


def nearest_depth(x: Array, y: Array, depth: Array, grid: Grid, reach: float) -> Array:
    """
    Return an image of what is nearest, free of gaps between neighbouring points.

    Parameters
    ----------
    x, y, depth
        (n,) metres.
    grid
        The pixels.
    reach
        Metres on each side of a gap that may be bridged; openings wider than twice that stay
        open, and nothing grows outwards.  What shines through such gaps from behind a nearer
        surface is hidden by it.

    Returns
    -------
    Array
        Metres, NaN where there is nothing.

    """
    inside, pixel = grid.pixels(x, y)
    image = np.full(grid.shape, np.nan)
    order = np.argsort(-depth[inside], kind='stable')       # of those in a pixel the last stays
    image.ravel()[pixel[order]] = depth[inside][order]
    known = np.isfinite(image)
    if not np.any(known):
        return image
    disc = _disc(reach / grid.cell)
    rows, columns = ndimage.distance_transform_edt(~known, return_distances=False,
                                                   return_indices=True)
    solid = ndimage.grey_opening(image[rows, columns], footprint=disc)
    return np.where(_closed(known, disc), solid, np.nan)


def blended(x: Array, y: Array, value: Array, grid: Grid, reach: float) -> Array:
    """Return an image of the mean value around each pixel; parameters as for `nearest_depth`."""
    inside, pixel = grid.pixels(x, y)
    count, total = (np.bincount(pixel, weight, grid.shape[0] * grid.shape[1]).reshape(grid.shape)
                    for weight in (None, value[inside]))
    smooth = 0.5 * reach / grid.cell
    weight, mean = (ndimage.gaussian_filter(sums.astype(float), smooth) for sums in (count, total))
    seen = _closed(count > 0, _disc(reach / grid.cell))
    return np.where(seen, mean / np.maximum(weight, 1e-12), np.nan)


def _disc(radius: float) -> NDArray[np.bool_]:
    across = np.arange(-int(np.ceil(radius)), int(np.ceil(radius)) + 1)
    return np.asarray(np.hypot(across, across[:, None]) <= radius)


def _closed(known: NDArray[np.bool_], disc: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask with its gaps closed, the picture's border left as it is."""
    edge = len(disc) // 2
    # padded, since beyond the border a closing sees nothing and would eat into the picture
    closed = ndimage.binary_closing(np.pad(known, edge), disc)
    inner = slice(edge, -edge if edge else None)
    return np.asarray(closed[inner, inner] | known)
