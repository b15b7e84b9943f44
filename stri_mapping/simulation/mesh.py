# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Triangles with surfaces: what the virtual scanners measure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

# Corners of the unit cube's faces, counter-clockwise seen from outside, vertex = 4 x + 2 y + z.
_CUBE = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


@dataclass(frozen=True)
class Surface:
    """
    What a range finder sees of a surface at 905 nm.

    Attributes
    ----------
    name
        Material, for people.
    reflectance
        Of a Lambertian surface, 0 to 1; a retroreflector has far more than 1.
    bias
        Systematic range error of this surface in metres, positive too far.

    """

    name: str
    reflectance: float
    bias: float = 0.0


@dataclass(frozen=True, eq=False)
class Mesh:
    """
    Triangle soup.

    Attributes
    ----------
    triangles
        (m, 3, 3) corners in metres; both sides are visible.
    surface
        (m,) index into `surfaces`.
    surfaces
        The surfaces there are.

    """

    triangles: Array
    surface: Indices
    surfaces: tuple[Surface, ...]

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.triangles)

    @property
    def normals(self) -> Array:
        """Unit normals (m, 3), right-handed about the corners' order."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        normals = np.cross(b - a, c - a)
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


class MeshBuilder:
    """Collects triangles, surface by surface."""

    def __init__(self) -> None:
        """Start empty."""
        self._triangles: list[Array] = []
        self._surface: list[Indices] = []
        self._surfaces: dict[Surface, int] = {}

    def mesh(self) -> Mesh:
        """Return what was added so far, less the triangles that have no area."""
        triangles = np.concatenate([np.empty((0, 3, 3)), *self._triangles])
        surface = np.concatenate([np.empty(0, np.int32), *self._surface])
        a, b, c = np.moveaxis(triangles, 1, 0)
        solid = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-9
        return Mesh(triangles[solid], surface[solid], tuple(self._surfaces))

    def add(self, triangles: Array, surface: Surface) -> None:
        """Add triangles (k, 3, 3)."""
        index = self._surfaces.setdefault(surface, len(self._surfaces))
        self._triangles.append(triangles)
        self._surface.append(np.full(len(triangles), index, np.int32))

    def quads(self, corners: ArrayLike, surface: Surface) -> None:
        """Add quadrilaterals (..., 4, 3), each of two triangles."""
        quads = np.asarray(corners, dtype=float).reshape(-1, 4, 3)
        self.add(np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), surface)

    def box(self, low: ArrayLike, high: ArrayLike, surface: Surface,
            T: Array | None = None) -> None:
        """Add an axis-aligned box between two corners, moved by the 4x4 `T` where given."""
        low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        corner = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing='ij'), -1).reshape(8, 3)
        vertices = low + corner * (high - low)
        self.quads(moved(vertices, T)[np.array(_CUBE)], surface)

    def prism(self, outline: ArrayLike, low: float, high: float, surface: Surface,
              T: Array | None = None) -> None:
        """Add an upright prism over a convex outline (k, 2), counter-clockwise from above."""
        base = np.asarray(outline, dtype=float)
        bottom, top = (np.column_stack([base, np.full(len(base), z)]) for z in (low, high))
        bottom, top = moved(bottom, T), moved(top, T)
        self.quads(np.stack([bottom, np.roll(bottom, -1, 0), np.roll(top, -1, 0), top], 1),
                   surface)
        for ring in (bottom[::-1], top):
            fan = [ring[[0, i, i + 1]] for i in range(1, len(ring) - 1)]
            self.add(np.array(fan), surface)


def moved(points: Array, T: Array | None) -> Array:
    """Return points (..., 3) moved by a 4x4 transform; as they are for None."""
    return points if T is None else points @ T[:3, :3].T + T[:3, 3]


def circle(x: float, y: float, radius: float, corners: int = 12) -> Array:
    """Return a regular outline (corners, 2) whose area is that of the circle."""
    angle = 2.0 * np.pi * (np.arange(corners) + 0.5) / corners
    r = radius * np.sqrt(2.0 * np.pi / corners / np.sin(2.0 * np.pi / corners))
    return np.column_stack([x + r * np.cos(angle), y + r * np.sin(angle)])


def write_ply(path: Path, mesh: Mesh) -> None:
    """
    Write a mesh as binary PLY: double vertices, faces with reflectance and range bias.

    The properties `reflectance` and `bias` (metres) of the faces are those of `Surface`.
    """
    vertices, index = np.unique(mesh.triangles.reshape(-1, 3), axis=0, return_inverse=True)
    header = '\n'.join([
        'ply', 'format binary_little_endian 1.0',
        f'element vertex {len(vertices)}', *(f'property double {c}' for c in 'xyz'),
        f'element face {len(mesh)}', 'property list uchar int vertex_indices',
        'property float reflectance', 'property float bias', 'end_header', ''])
    faces = np.empty(len(mesh), [('n', 'u1'), ('v', '<i4', 3), ('r', '<f4'), ('b', '<f4')])
    faces['n'], faces['v'] = 3, index.reshape(-1, 3)
    faces['r'] = np.array([s.reflectance for s in mesh.surfaces])[mesh.surface]
    faces['b'] = np.array([s.bias for s in mesh.surfaces])[mesh.surface]
    path.write_bytes(header.encode() + vertices.astype('<f8').tobytes() + faces.tobytes())
