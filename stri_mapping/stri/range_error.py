# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The pull of slanted footprints, learnt from the straightness of streets.

Where a beam meets a wall at an angle, the near side of its footprint answers first: the range is
short by b (r tan(incidence))^2.  That bends a straight wall, and a bent wall that passes by turns
the estimated heading with every metre driven: degrees in a street.  Long plain walls show their
bend themselves (see `straightness`); most are too short, and have steps of their own.  But houses
of one street stand in line: with the wrong b their directions drift with the way, with the right
one they come back again and again.  So b is what makes the directions of walls along the way fall
together best, whatever other directions there are besides: parked cars, side streets, the street
after the next corner.  That takes a hundred metres; before it, what is seen at one moment ahead
and behind tells most (see `slant`).
"""

from __future__ import annotations

from collections.abc import Callable
import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.slant import Slants
from stri_mapping.stri.straightness import Bends, commonest_normal
from stri_mapping.stri.surfel import NORMAL_VAR, NX, NY, X, Y

Array = NDArray[np.float64]

CANDIDATES = np.arange(-3e-5, 9.01e-5, 0.25e-5)
# Radians of heading by metre driven and by b: 2 for rays near the perpendicular, more beyond.
TURN = 2.6
STREET = 300.0        # metres within which houses stand in line, then afresh
EVERY = 1.0           # metres driven between looks
SAME_WALL = 10.0      # metres of one wall: so many looks count as one
BIN = math.radians(0.05)
BINS = round(math.pi / BIN)
WIDTH = math.radians(0.15)          # by which walls of one street differ, standard deviation
REACH = 8                           # bins of the kernel to either side
KERNEL = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) * BIN / WIDTH) ** 2)
NEAR = math.radians(4.0)            # from the commonest direction to what still belongs to it
SPREAD = 0.01                       # radians from it at which a surfel counts half


class RangeError:
    """
    Running estimate of the pull.

    Parameters
    ----------
    mean, sigma, smooth
        What is known of b before anything is seen, 1/m, if it is a pull that grows smoothly with
        the slant, and how likely that is (see `slant`).

    Attributes
    ----------
    value
        b in 1/m.

    """

    def __init__(self, mean: float, sigma: float, smooth: float) -> None:
        """Start from the prior."""
        self._slants = Slants(CANDIDATES, mean, sigma, smooth)
        self._streets = np.zeros(len(CANDIDATES))         # what streets before say
        self._street = np.zeros(len(CANDIDATES))          # and with this one
        self._seen = np.zeros((len(CANDIDATES), BINS))    # directions, turned back by each b
        self._together = np.zeros(len(CANDIDATES))        # how much they fall together
        self._bends = Bends()
        self._looks = 0
        self._way = 0.0           # metres along the walls
        self._turned = 0.0        # m times b that was corrected on the way
        self._normal = math.nan   # of the wall seen last, from the scanner
        self._last = np.full(2, np.nan)
        self.value = self._likely()

    def learn(
        self, surfels: Array, walls: Callable[[], Array], pose: Array, travelled: float,
    ) -> None:
        """
        Take one keyframe.

        Parameters
        ----------
        surfels
            (n, SURFEL) of the keyframe, uncorrected.
        walls
            Gives its pieces of wall (m, PIECE), see `slant.pieces`; called every metre.
        pose
            (3,) of the scanner in its first frame, as estimated.
        travelled
            Metres of path so far.

        """
        self._bends.add(surfels, travelled, self.value)
        step = pose[:2] - self._last
        if math.hypot(*step) < EVERY:
            return
        normal, slant = _direction(surfels)
        if not math.isnan(normal):
            self._normal = normal
        if not np.isnan(step).any() and not math.isnan(self._normal):
            across = self._normal + pose[2]
            along = float(step[1] * math.cos(across) - step[0] * math.sin(across))
            self._way += along
            self._turned += along * self.value
        self._last = pose[:2].copy()
        if not math.isnan(normal):
            self._look(normal + pose[2], slant)
        self._slants.add(walls(), self.value)
        self.value = self._likely()

    def _look(self, direction: float, slant: float) -> None:
        """Take a wall's direction in the first scan's frame, and what b turns it at its slant."""
        turned = CANDIDATES * (TURN * self._way + slant) - TURN * self._turned
        _gather(((direction - turned) % math.pi) / BIN, KERNEL, self._seen, self._together)
        self._looks += 1
        weight = self._looks / SAME_WALL
        self._street = self._streets + weight * np.log(self._together / self._together.max())
        if abs(self._way) > STREET:
            self._streets = self._street
            self._seen[:] = self._together[:] = 0.0
            self._looks, self._way, self._turned = 0, 0.0, 0.0

    def _likely(self) -> float:
        """Return the mean of b by all that is known."""
        mean, information = self._bends.mean()
        log = self._street + self._slants.log() - 0.5 * information * (CANDIDATES - mean) ** 2
        likely = np.exp(log - log.max())
        return float(likely @ CANDIDATES / likely.sum())


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _gather(places: Array, kernel: Array, seen: Array, together: Array) -> None:
    """Add one direction at its bin for each candidate, and how it falls together with others."""
    bins = seen.shape[1]
    reach = len(kernel) // 2
    for c in range(len(places)):
        k = int(places[c]) % bins
        near = 0.0
        for i in range(-reach, reach + 1):
            near += kernel[reach + i] * seen[c, (k + i) % bins]
        together[c] += 1.0 + 2.0 * near
        seen[c, k] += 1.0


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _direction(surfels: Array) -> tuple[float, float]:
    """
    Return the commonest normal, pointing away from the scanner, and by how much b turns it.

    The latter for the slants at which its surfels are met, radians by 1/m; both are NaN where
    there is too little to tell.
    """
    best = commonest_normal(surfels, np.ones(len(surfels), np.bool_))
    if best < 0:
        return np.nan, np.nan
    middle = math.radians(best + 0.5)
    nx, ny = math.cos(middle), math.sin(middle)
    beyond, mean, slant = 0.0, 0.0, 0.0
    for iteration in range(6):
        total, turned, slanted = 1e-12, 0.0, 0.0
        for k in range(len(surfels)):
            off = math.atan2(nx * surfels[k, NY] - ny * surfels[k, NX],
                             nx * surfels[k, NX] + ny * surfels[k, NY])
            off -= math.pi * round(off / math.pi)
            if abs(off) > NEAR:
                continue
            across = nx * surfels[k, X] + ny * surfels[k, Y]
            along = nx * surfels[k, Y] - ny * surfels[k, X]
            w = 1.0 / (max(surfels[k, NORMAL_VAR], 1e-5) + SPREAD ** 2)
            beyond += math.copysign(1.0, across)
            if iteration > 0:
                w /= (1.0 + ((off - mean) / SPREAD) ** 2) ** 2
            away = max(abs(across), 2.0)
            r = math.hypot(across, along)
            total += w
            turned += w * off
            slanted += w * math.copysign(2.0 * along * r + along ** 3 / r, along * across) / away
        mean, slant = turned / total, slanted / total
    return middle + mean + (0.0 if beyond > 0.0 else math.pi), slant
