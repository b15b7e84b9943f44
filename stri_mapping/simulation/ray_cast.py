# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""First hits of rays on triangles: found by Embree, measured in double precision."""

from __future__ import annotations

from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.simulation.mesh import Mesh

Array = NDArray[np.float64]
Indices = NDArray[np.int32]


class RayCaster:
    """
    A mesh prepared for ray casting.

    Attributes
    ----------
    reflectance, bias
        (m,) of every triangle's surface, see `stri_mapping.simulation.mesh.Surface`.
    centre, radius
        Sphere around the mesh, metres.

    """

    def __init__(self, mesh: Mesh) -> None:
        """Build Embree's tree."""
        self._scene = EmbreeScene()
        self._embree_mesh = TriangleMesh(self._scene, mesh.triangles.astype(np.float32))
        self._corner = np.ascontiguousarray(mesh.triangles[:, 0])
        self._normal = np.ascontiguousarray(mesh.normals)
        self.reflectance = np.array([s.reflectance for s in mesh.surfaces])[mesh.surface]
        self.bias = np.array([s.bias for s in mesh.surfaces])[mesh.surface]
        corners = mesh.triangles.reshape(-1, 3)
        self.centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        self.radius = float(np.linalg.norm(corners - self.centre, axis=1).max())

    def cast(self, origins: Array, directions: Array) -> tuple[Array, Array, Indices]:
        """
        Return distance, cosine of incidence and triangle of each ray's first hit.

        Embree finds the triangle in single precision; the distance is that to the triangle's
        plane in double precision, so that it is exact however far from the origin the scene is.

        Parameters
        ----------
        origins, directions
            (n, 3); directions of unit length, metres.

        Returns
        -------
        distance : Array
            (n,) metres, +inf for no hit.
        cosine : Array
            (n,) of the angle between ray and normal, 0 to 1; 0 for no hit.
        triangle : Indices
            (n,), -1 for no hit.

        """
        triangle = self._scene.run(origins.astype(np.float32), directions.astype(np.float32))
        distance, cosine = _measure(origins, directions, triangle, self._corner, self._normal)
        return distance, cosine, triangle


@numba.njit(cache=True)
def _measure(  # type: ignore[no-untyped-def]
    origins, directions, triangle, corner, normal,
):
    """Return distance to and cosine against the plane of each ray's triangle."""
    distance = np.full(len(triangle), np.inf)
    cosine = np.zeros(len(triangle))
    for i in range(len(triangle)):
        k = triangle[i]
        if k < 0:
            continue
        along = 0.0
        height = 0.0
        for c in range(3):
            along += normal[k, c] * directions[i, c]
            height += normal[k, c] * (corner[k, c] - origins[i, c])
        if along != 0.0:
            distance[i] = height / along
            cosine[i] = abs(along)
    return distance, cosine
