# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A scene: a street that stands still, what moves in it, and the vehicle's own motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.simulation.mesh import Mesh
from stri_mapping.simulation.motion import Motion
from stri_mapping.simulation.ray_cast import RayCaster
from stri_mapping.simulation.slope import levelled
from stri_mapping.simulation.traffic import Mover

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Within this angle of the sun a receiver at 905 nm is dazzled.
DAZZLE = np.deg2rad(2.5)


@dataclass(frozen=True, eq=False)
class Scene:
    """
    Everything a virtual scanner meets, as a function of time.

    Attributes
    ----------
    name
        Of the scene.
    mesh
        What stands still, in odom.
    motion
        Of the vehicle, base_link in odom.
    duration
        Seconds.
    movers
        What moves.
    sun
        (3,) unit vector in odom towards the sun; None for an overcast sky.
    facts
        What is true of the scene, for people and tests; plain JSON values.
    grade
        (2,) rise of the ground per metre along x and y, which `mesh` and `motion` have; movers
        have it from here.

    """

    name: str
    mesh: Mesh
    motion: Motion
    duration: float
    movers: tuple[Mover, ...] = ()
    sun: Array | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    grade: Array = field(default_factory=lambda: np.zeros(2))

    @cached_property
    def still(self) -> RayCaster:
        """What stands still, prepared for ray casting."""
        return RayCaster(self.mesh)

    def look(self, times: Array, origins: Array, directions: Array) -> tuple[Array, Array]:
        """
        Return how far the light of beams goes and how much of it comes back.

        Parameters
        ----------
        times
            (n,) seconds at which the beams are sent.
        origins, directions
            (n k, 3) in odom, the k sub-rays of a beam together and its middle first; directions
            of unit length.

        Returns
        -------
        distance : Array
            (n k,) metres as a range finder reads them, the surface's range bias included; +inf
            for no hit.
        energy : Array
            (n k,) reflectance times cosine of incidence over distance squared; 0 for no hit.

        """
        distance, energy = _light(self.still, origins, directions)
        stretch = np.ones(len(origins))
        if self.movers and self.grade.any():
            origins, directions, stretch = levelled(origins, directions, self.grade)
        distance *= stretch
        for mover in self.movers:
            if mover.begin <= times[-1] and times[0] <= mover.end:
                _look_at(mover, times, origins, directions, distance, energy)
        return distance / stretch, energy

    def dazzled(self, directions: Array, ranges: Array) -> Mask:
        """Return which beams (n,) look into the sun: those towards it that meet nothing."""
        if self.sun is None:
            return np.zeros(len(ranges), dtype=bool)
        return np.asarray((directions @ self.sun > np.cos(DAZZLE)) & np.isinf(ranges))


def _light(caster: RayCaster, origins: Array, directions: Array) -> tuple[Array, Array]:
    """Return distance with bias, and energy, of rays in the caster's frame."""
    distance, cosine, triangle = caster.cast(origins, directions)
    energy = caster.reflectance[triangle] * cosine / np.maximum(distance, 0.05) ** 2
    return distance + caster.bias[triangle], energy


def _look_at(mover: Mover, times: Array, origins: Array, directions: Array, distance: Array,
             energy: Array) -> None:
    """Put a mover before what `distance` and `energy` (n k,) have, where it is nearer."""
    there = (mover.begin <= times) & (times <= mover.end)
    rays, at, along = _in_frame(mover.at(times), there, origins, directions,
                                mover.caster.centre, mover.caster.radius)
    if not len(rays):
        return
    found, light = _light(mover.caster, at, along)
    nearer = found < distance[rays]
    distance[rays[nearer]] = found[nearer]
    energy[rays[nearer]] = light[nearer]


@numba.njit(cache=True)
def _in_frame(  # type: ignore[no-untyped-def]
    poses, there, origins, directions, centre, radius,
):
    """
    Return the rays that come near a body, in its frame.

    Beams (n,) of k sub-rays each are chosen whole, by their middle's distance from the sphere
    around the body; they spread by less than 1 % of their length.  Poses (n, 3) are the body's
    at the beams' times.
    """
    n = len(poses)
    k = len(origins) // n
    met = np.zeros(n, dtype=np.bool_)
    to = np.empty(3)
    for i in range(n):
        if not there[i]:
            continue
        c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        to[0] = poses[i, 0] + c * centre[0] - s * centre[1] - origins[i * k, 0]
        to[1] = poses[i, 1] + s * centre[0] + c * centre[1] - origins[i * k, 1]
        to[2] = centre[2] - origins[i * k, 2]
        ahead, square = 0.0, 0.0
        for m in range(3):
            ahead += to[m] * directions[i * k, m]
            square += to[m] * to[m]
        reach = radius + 0.01 * abs(ahead)
        met[i] = ahead > -radius and square - ahead * ahead < reach * reach
    rays = np.empty(k * met.sum(), dtype=np.int64)
    at = np.empty((len(rays), 3))
    along = np.empty((len(rays), 3))
    j = 0
    for i in range(n):
        if not met[i]:
            continue
        c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        for r in range(i * k, (i + 1) * k):
            x, y = origins[r, 0] - poses[i, 0], origins[r, 1] - poses[i, 1]
            at[j, 0], at[j, 1], at[j, 2] = c * x + s * y, c * y - s * x, origins[r, 2]
            x, y = directions[r, 0], directions[r, 1]
            along[j, 0], along[j, 1], along[j, 2] = c * x + s * y, c * y - s * x, directions[r, 2]
            rays[j] = r
            j += 1
    return rays, at, along
