# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
What a keyframe says of slanted footprints: walls have one direction, at whatever slant.

A pull bends a wall more the more slanted it is met (see `range_error`): each piece of it is
turned, most where it is grazed.  Houses of a street stand in line, so at one moment all
that is seen of them, ahead and behind, has one direction, or that at a right angle, once the pull
is taken off.  Rays too slanted to tell the motion tell the pull best: with b = 4e-5 1/m a wall 8 m
to the side is turned by 0.06 degrees where it is met at 45 degrees from its normal, 0.3 at 75.

Devices differ.  Either the pull grows smoothly with the slant; or ranges are right up to some
slant, and beyond it the footprint's near side is what is measured, which turns all that is ahead
one way, all that is behind the other, by half the beam's width; or there is no pull at all.  These
three are weighed against each other.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from stri_mapping.stri.rays import LONE, LONE_RAY, RANGE
from stri_mapping.stri.surfel import (
    MIN_POINTS,
    neighbours,
    number_runs,
    running_sums,
    straight,
    WINDOWS,
)

Array = NDArray[np.float64]

# columns of a piece of wall: direction of its normal, radians; how far b = 1 1/m turns it; which
# way, and how fully, a near side of 1 radian does; 1 / variance of the direction
DIRECTION, PULLED, NEAR_SIDE, WEIGHT = range(4)
PIECE = 4
EVERY = 3                   # points of which one is asked for its piece of wall
SURE = 0.02                 # radians, of a piece's direction, beyond which it says nothing
CROOKED = 0.002             # radians by which pieces of one wall differ, standard deviation
SCALE = 0.004               # radians from the common direction at which a piece counts a quarter
ROUNDS = (4.0, 2.0, 1.0, 1.0, 1.0)      # times the scale
FEWEST = 30                 # pieces in a keyframe that are believed
BINS = 360                  # of directions, over a right angle

# Slants are metres of range by radian of bearing, q = r tan(incidence).  Beyond the last nothing
# is seen; at DEEP the footprint is deeper than the pulse's edge, and the pull half of b q^2; at
# KNEE the near side begins to be what is measured, half of it, where it is.
LAST, DEEP, KNEE = 140.0, 130.0, 18.0

# What is weighed: pulls in 1/m, and near sides in radians, how likely these are beforehand, and
# by how much a device of either kind that does not pull where rays are used may pull there yet.
PULLS = np.linspace(-3e-5, 9e-5, 13)
NEAR_SIDES = np.array([0.0, 2e-3, 4e-3, 6e-3, 8e-3, 11e-3])
LIKELY_NEAR, LIKELY_NEAR_SIGMA = 5e-3, 3e-3
NOTHING, LITTLE = (0.0, 0.8e-5), (0.5e-5, 1.0e-5)
# Looks a metre apart see the same walls: so much of one is new; and no single one says more than
# so much, since a wall askew is seen for many metres.
NEW, MOST = 0.3, 1.0


class Slants:
    """
    What all looks so far say of the pull.

    Parameters
    ----------
    candidates
        (c,) pulls in 1/m for which it is told.
    mean, sigma
        Of a pull that grows smoothly, before anything is seen, 1/m.
    smooth
        How likely it is that there is such a pull, 0 to 1.

    """

    def __init__(self, candidates: Array, mean: float, sigma: float, smooth: float) -> None:
        """Start without a look."""
        self._between = CubicSpline(PULLS, np.eye(len(PULLS)))(candidates)
        self._laws = np.zeros((len(PULLS) + len(NEAR_SIDES), 2))
        self._laws[:len(PULLS), 0], self._laws[len(PULLS):, 1] = PULLS, NEAR_SIDES
        self._against = np.zeros(len(self._laws))       # what is said against each
        self._smooth = smooth * _density(candidates, mean, sigma)
        rest = 0.5 * (1.0 - smooth)
        self._nothing = rest * _density(candidates, *NOTHING)
        self._little = rest * _density(candidates, *LITTLE)
        self._near = _density(NEAR_SIDES, LIKELY_NEAR, LIKELY_NEAR_SIGMA)

    def add(self, found: Array, likely: float) -> None:
        """Take the pieces of wall (m, PIECE) of one keyframe; likely is the pull known so far."""
        if len(found) >= FEWEST:
            apart = NEW * disagreement(found, likely, self._laws)
            self._against -= MOST * np.expm1(-(apart - apart.min()) / MOST)

    def log(self) -> Array:
        """Return the logarithm (c,) of how likely each candidate is."""
        against = self._against - self._against.min()
        pull, near = against[:len(PULLS)], against[len(PULLS):]
        smooth = np.exp(-np.maximum(self._between @ pull, 0.0)) * self._smooth
        near_side = np.exp(-near) @ self._near * self._little
        nothing = np.exp(-near[0]) * self._nothing
        return np.asarray(np.log(smooth + near_side + nothing + 1e-300))


def _density(at: Array, mean: float, sigma: float) -> Array:
    density = np.exp(-0.5 * ((at - mean) / sigma) ** 2)
    return np.asarray(density / density.sum())


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def pieces(points: Array, bearings: Array, rays: Array) -> Array:
    """
    Return the directions of straight pieces of wall among merged points.

    Parameters
    ----------
    points, bearings
        (n, 2) and (n,) in the keyframe's frame, see `keyframe.merge`.
    rays
        (n, RAY) that they are from.

    Returns
    -------
    Array
        (m, PIECE), see the columns above.

    """
    use = np.flatnonzero(rays[:, LONE] != LONE_RAY)
    order = use[np.argsort(bearings[use])]
    n = len(order)
    xy = points[order]
    runs = number_runs(xy)
    sums = running_sums(xy, rays[order, RANGE], np.zeros(n))[0]
    low, high = np.empty((len(WINDOWS), n), np.int32), np.empty((len(WINDOWS), n), np.int32)
    for w in range(1, len(WINDOWS)):
        neighbours(xy, runs, WINDOWS[w], low[w], high[w])
    found, count = np.empty((n // EVERY + 1, PIECE)), 0
    for i in range(0, n, EVERY):
        nx, ny, _, variance = straight(i, xy, sums, low, high, 1, MIN_POINTS)
        if variance > SURE ** 2:
            continue
        facing = max(-(nx * xy[i, 0] + ny * xy[i, 1]), 0.3)
        along = -ny * xy[i, 0] + nx * xy[i, 1]
        slant = math.hypot(facing, along) * abs(along) / facing
        if slant < LAST:
            found[count, DIRECTION] = math.atan2(ny, nx)
            found[count, PULLED] = -math.copysign(turned(facing, abs(along)), along)
            found[count, NEAR_SIDE] = -math.copysign(
                min(max((slant / KNEE - 0.7) / 0.6, 0.0), 1.0), along)
            found[count, WEIGHT] = 1.0 / (variance + CROOKED ** 2)
            count += 1
    return found[:count]


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def turned(d: float, x: float) -> float:
    """
    Return by how much b = 1 1/m turns a wall, radians, x metres along it from its foot at d.

    The wall seems nearer by y = cos(a) P(q), q = r tan(a) = r x / d, P = q^2 / (1 + q / DEEP);
    this is dy/dx.  Both lengths in metres, positive.
    """
    r = math.hypot(d, x)
    q = r * x / d
    pull = q * q / (1.0 + q / DEEP)
    growth = (2.0 * q + q * q / DEEP) / (1.0 + q / DEEP) ** 2
    return growth * (2.0 * x * x + d * d) / (r * r) - pull * d * x / r ** 3


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def disagreement(found: Array, likely: float, laws: Array) -> Array:
    """
    Return how far pieces of wall are from one direction once what a law says is taken off.

    Parameters
    ----------
    found
        (m, PIECE), m at least 1.
    likely
        The pull as known so far, 1/m, by which the commonest direction is found.
    laws
        (k, 2) pull in 1/m and near side in radians.

    Returns
    -------
    Array
        (k,) half the sum of squared residuals, by their variance (Geman-McClure).

    """
    start = _commonest(found, likely)
    apart = np.empty(len(laws))
    for law in range(len(laws)):
        mean, squares = start, 0.0
        for scale in ROUNDS:
            scale *= SCALE
            total, moment, squares = 0.0, 0.0, 0.0
            for k in range(len(found)):
                off = laws[law, 0] * found[k, PULLED] + laws[law, 1] * found[k, NEAR_SIDE]
                # to the nearest right angle
                e = (found[k, DIRECTION] - off - mean + 0.25 * math.pi) % (0.5 * math.pi)
                e -= 0.25 * math.pi
                z = (e / scale) ** 2
                w = found[k, WEIGHT] / (1.0 + z) ** 2
                total += w
                moment += w * e
                squares += 0.5 * found[k, WEIGHT] * scale * scale * z / (1.0 + z)
            mean += moment / total
        apart[law] = squares
    return apart


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _commonest(found: Array, pull: float) -> float:
    """Return the direction of most pieces, modulo a right angle, to a quarter of a degree."""
    votes = np.zeros(BINS)
    for k in range(len(found)):
        place = (found[k, DIRECTION] - pull * found[k, PULLED]) % (0.5 * math.pi)
        votes[int(place * (BINS / (0.5 * math.pi))) % BINS] += found[k, WEIGHT]
    smooth = votes + np.roll(votes, 1) + np.roll(votes, -1)
    return (np.argmax(smooth) + 0.5) * (0.5 * math.pi / BINS)
