# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
How sure the path is: information of the newest knots with everything older marginalised.

The fit holds old knots fixed, which says nothing of their error.  Here the same pairs and
priors are added up once each, in a window of knots from which the oldest is eliminated as the
window moves on, so that the error of the whole way back to the first scan remains.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.pairs import relative
from stri_mapping.stri.priors import add_differences, SECOND, THIRD
from stri_mapping.stri.smoother import add_pair, product
from stri_mapping.stri.spline import basis, pose_at
from stri_mapping.stri.window import Keyframes, Pairs

Array = NDArray[np.float64]
Index = NDArray[np.int64]

WINDOW = 16
# A pair's residuals are not independent of one another nor of other pairs': so many count as
# one.  With this, errors over 1 s of drives without mishap are about what is stated.
DILUTION = 25.0
# What a vehicle does when nobody looks, standard deviations: m/s^2 and rad/s^2.  Independent from
# knot to knot, so that seconds of the same braking need as much.
JERK, ANGULAR_JERK = 6.0, 3.0
ACCELERATION, ANGULAR_ACCELERATION = 7.0, 1.5


class Uncertainty:
    """
    Covariances of the spline's newest part.

    Parameters
    ----------
    spacing
        Knot spacing in seconds.

    Attributes
    ----------
    covariance
        (3 n, 3 n) of the coefficients of the newest knots, in the first scan's frame.
    first
        Knot of the first of them.

    """

    def __init__(self, spacing: float) -> None:
        """Start before the first knot."""
        self.h = spacing
        self.first = 0
        self._information: Array = np.zeros((0, 0))
        self.covariance: Array = np.zeros((0, 0))
        self._jerk = np.array([JERK, JERK, ANGULAR_JERK]) ** -2.0 * spacing ** -6
        self._acceleration = np.array(
            [ACCELERATION, ACCELERATION, ANGULAR_ACCELERATION]) ** -2.0 * spacing ** -4

    def extend(
        self, knots: Array, last: int, pairs: Pairs, frames: Keyframes, newest: float,
    ) -> None:
        """
        Add what came with the newest knots.

        Parameters
        ----------
        knots
            (k, 3) the fitted spline.
        last
            One beyond the newest fitted knot.
        pairs, frames
            The pairs in the fit; those with a keyframe at or after `newest` are added.
        newest
            Seconds.

        """
        size = 3 * (last - self.first)
        old = len(self._information)
        information: Array = np.zeros((size, size))
        information[:old, :old] = self._information
        if old == 0:
            weights = np.empty(4)
            basis(0.0, weights)
            # the first scan defines the frame
            held = np.kron(np.outer(weights, weights), np.eye(3))
            information[3:15, 3:15] += 1e8 * held
        information += _new_prior(old // 3, size // 3, self._jerk, self._acceleration)
        n = pairs.count
        _add(knots, self.h, self.first, pairs.ends[:n], pairs.hessian[:n],
             frames.time, frames.pose, newest, information)
        information[np.diag_indices(size)] += 1e-9
        drop = 3 * max(0, last - self.first - WINDOW)
        if drop:
            kept = np.linalg.solve(information[:drop, :drop], information[:drop, drop:])
            information = np.asarray(
                information[drop:, drop:] - information[drop:, :drop] @ kept, np.float64)
            self.first += drop // 3
        self._information = np.asarray(0.5 * (information + information.T), np.float64)
        self.covariance = np.asarray(np.linalg.inv(self._information), np.float64)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _new_prior(done: int, count: int, jerk: Array, acceleration: Array) -> Array:
    """Return the priors' information on a window's knots, but for those among the first done."""
    knots, slope = np.zeros((count, 3)), np.zeros(3 * count)
    information = np.zeros((3 * count, 3 * count))
    before = np.zeros((3 * count, 3 * count))
    add_differences(knots, 0, count, 0, THIRD, jerk, np.inf, information, slope)
    add_differences(knots, 0, count, 0, SECOND, acceleration, np.inf, information, slope)
    add_differences(knots, 0, done, 0, THIRD, jerk, np.inf, before, slope)
    add_differences(knots, 0, done, 0, SECOND, acceleration, np.inf, before, slope)
    return information - before


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _add(
    knots: Array, h: float, first: int, ends: Index, hessian: Array, time: Array,
    pose: Array, newest: float, information: Array,
) -> None:
    weights_a, weights_b = np.empty(4), np.empty(4)
    scratch, delta = np.empty(3), np.empty(3)
    blocks, turn = np.empty((5, 3, 3)), np.eye(3)
    none, slope = np.zeros(3), np.zeros(len(information))
    for p in range(len(ends)):
        a, b = ends[p]
        if max(time[a], time[b]) < newest:
            continue
        ka, kb = int(math.floor(time[a] / h)), int(math.floor(time[b] / h))
        pose_a, pose_b = pose[a].copy(), pose[b].copy()
        # a keyframe older than the window hangs rigidly on the window's oldest knot
        if ka < first:
            pose_a[:] = knots[first]
            weights_a[:] = 0.0
            weights_a[0] = 1.0
            ka = first
        else:
            pose_at(knots, h, time[a], weights_a, scratch)
        if kb < first:
            pose_b[:] = knots[first]
            weights_b[:] = 0.0
            weights_b[0] = 1.0
            kb = first
        else:
            pose_at(knots, h, time[b], weights_b, scratch)
        relative(pose_a, pose_b, delta)
        _moved_information(hessian[p], pose[b], pose[a], pose_b, pose_a, turn)
        add_pair(ka - first, kb - first, weights_a, weights_b, pose_b, delta, turn, none,
                 1.0 / DILUTION, blocks, information, slope)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _moved_information(
    hessian: Array, b: Array, a: Array, b_moved: Array, a_moved: Array, out: Array,
) -> None:
    """
    Write the information about inv(b_moved) a_moved that hessian gives about inv(b) a.

    b = b_moved * d and a = a_moved * e with d, e rigid: z = inv(d) * z_moved * e.
    """
    # dz = R(d)^-1 (dt_moved + dyaw J R(z_moved) t_e), dyaw = dyaw_moved
    turn = b_moved[2] - b[2]
    cos, sin = math.cos(turn), math.sin(turn)
    dx, dy = a[0] - a_moved[0], a[1] - a_moved[1]
    cb, sb = math.cos(b_moved[2]), math.sin(b_moved[2])
    ex, ey = cb * dx + sb * dy, -sb * dx + cb * dy
    G = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    G[0, 2] = -cos * ey - sin * ex
    G[1, 2] = -sin * ey + cos * ex
    product(G, hessian, G, 1.0, out)
