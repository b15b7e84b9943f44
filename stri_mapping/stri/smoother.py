# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The joint fit: the active knots of the spline against all pairs of keyframes and the priors.

Pairs are condensed (see `pairs`) and linearised again only when their relative pose has moved,
so that an iteration costs little more than a 36 x 36 solve.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.pairs import linearise, relative
from stri_mapping.stri.spline import pose_at

Array = NDArray[np.float64]
Index = NDArray[np.int64]

RESIDUALS = 200                   # of a pair, about: more of one keyframe tell little new
MOVED, TURNED = 0.003, 0.0007     # metres, radians: beyond, a pair is linearised again
STOP = 2e-4                       # metres or radians: the fit has converged
# Residuals of one surface repeat the same error in every pair; this many count as one.
DILUTION = 60.0
ANCHOR = 1e8
TAIL = 2.0                # standard deviations beyond which a jerk is taken as it comes
VOTES = 1.2        # seconds between keyframes whose comparison tells what moves
THIRD, SECOND = np.array([-1.0, 3.0, -3.0, 1.0]), np.array([1.0, -2.0, 1.0])
FIRST = np.array([-1.0, 1.0])


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def solve(
    knots: Array, h: float, first: int, last: int, start: int, ends: Index, z: Array,
    hessian: Array, gradient: Array, passes: Index, time: Array, pose: Array, surfels: Array,
    counts: Index, bins: NDArray[np.int32], scales: Array, newest: float, iterations: int,
    jerk: Array, acceleration: Array, straight: Array, pull: float, trust: Array,
    forward: Array, votes: Array,
) -> None:
    """
    Fit knots first .. last - 1 by Gauss-Newton; earlier ones stay as they are.

    Parameters
    ----------
    knots, h
        (k, 3) spline coefficients, changed in place, and knot spacing in seconds.
    start
        Knot at which the motion was taken up: it is held in its place where it is active, and no
        prior ties it to the motion before.
    ends .. passes
        The pairs in use, see `window.Pairs`.
    time .. bins
        The keyframes, see `window.Keyframes`; `pose` is brought up to date.
    scales
        Geman-McClure scales of the iterations, the last for all that follow.
    newest
        Pairs with a keyframe at or after this time anneal by `scales`.
    jerk, acceleration, straight
        (3,) prior information of third, second and first differences of the coefficients.
    pull, trust, forward, votes
        See `pairs.linearise`; neighbours in time among the newest pairs vote.

    """
    n = last - first
    information, slope = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    for i in range(iterations):
        information[:], slope[:] = 0.0, 0.0
        scale, final = scales[min(i, len(scales) - 1)], scales[-1]
        _add_pairs(
            knots, h, first, ends, z, hessian, gradient, passes, time, pose, surfels, counts,
            bins, scale, final, newest, pull, trust, forward, votes, information, slope)
        add_prior(knots, first, last, start, THIRD, jerk, TAIL, information, slope)
        add_prior(knots, first, last, start, FIRST, straight, np.inf, information, slope)
        add_prior(knots, first, last, start, SECOND, acceleration, np.inf, information, slope)
        for d in range(3 * n):
            information[d, d] += 1e-6
        if start >= first:
            for d in range(9):
                row = 3 * (start - first) + d
                information[row, row] += ANCHOR if d < 3 else 1e2
        step = np.linalg.solve(information, -slope)
        for k in range(n):
            for d in range(3):
                knots[first + k, d] += step[3 * k + d]
        if np.abs(step).max() < STOP and i >= len(scales) - 1:
            break


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _add_pairs(
    knots: Array, h: float, first: int, ends: Index, z: Array, hessian: Array, gradient: Array,
    passes: Index, time: Array, pose: Array, surfels: Array, counts: Index,
    bins: NDArray[np.int32], scale: float, final: float, newest: float, pull: float,
    trust: Array, forward: Array, votes: Array, information: Array, slope: Array,
) -> None:
    weights_a, weights_b = np.empty(4), np.empty(4)
    now, shift = np.empty(3), np.empty(3)
    jacobian, columns = np.zeros((3, 24)), np.zeros(24, np.int64)
    still = np.zeros(2)
    for p in range(len(ends)):
        a, b = ends[p]
        ka, kb = int(math.floor(time[a] / h)), int(math.floor(time[b] / h))
        if ka + 3 < first and kb + 3 < first:
            continue
        if ka + 3 >= first:
            pose_at(knots, h, time[a], weights_a, pose[a])
        if kb + 3 >= first:
            pose_at(knots, h, time[b], weights_b, pose[b])
        relative(pose[a], pose[b], now)
        new = max(time[a], time[b]) >= newest
        moved = abs(now[0] - z[p, 0]) + abs(now[1] - z[p, 1]) > MOVED
        turned = abs(now[2] - z[p, 2]) > TURNED
        if passes[p] == 0 or moved or turned or (new and passes[p] < 3):
            stride = max(1, counts[a] // RESIDUALS)
            linearise(
                surfels[a], counts[a], surfels[b], counts[b], bins[b], now,
                scale if new else final, (a + b) % stride, stride, pull, trust,
                forward if time[a] >= newest and 0.0 < time[a] - time[b] < VOTES else still,
                hessian[p], gradient[p], votes)
            z[p] = now
            passes[p] += 1
        for d in range(3):
            shift[d] = now[d] - z[p, d]
        g = gradient[p] + hessian[p] @ shift
        m = chain(ka - first, kb - first, weights_a, weights_b, pose[b], now, jacobian, columns)
        _scatter(jacobian, columns, m, hessian[p], g, information, slope)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def chain(
    ka: int, kb: int, weights_a: Array, weights_b: Array, pose_b: Array, z: Array,
    jacobian: Array, columns: Index,
) -> int:
    """Write dz / d(active coefficients) and the coefficients' rows; return how many."""
    cos, sin = math.cos(pose_b[2]), math.sin(pose_b[2])
    m = 0
    for i in range(4):
        if ka + i >= 0:
            f = weights_a[i]
            jacobian[0, m], jacobian[0, m + 1], jacobian[0, m + 2] = f * cos, f * sin, 0.0
            jacobian[1, m], jacobian[1, m + 1], jacobian[1, m + 2] = -f * sin, f * cos, 0.0
            jacobian[2, m], jacobian[2, m + 1], jacobian[2, m + 2] = 0.0, 0.0, f
            for d in range(3):
                columns[m + d] = 3 * (ka + i) + d
            m += 3
        if kb + i >= 0:
            f = weights_b[i]
            jacobian[0, m], jacobian[0, m + 1], jacobian[0, m + 2] = -f * cos, -f * sin, f * z[1]
            jacobian[1, m], jacobian[1, m + 1], jacobian[1, m + 2] = f * sin, -f * cos, -f * z[0]
            jacobian[2, m], jacobian[2, m + 1], jacobian[2, m + 2] = 0.0, 0.0, -f
            for d in range(3):
                columns[m + d] = 3 * (kb + i) + d
            m += 3
    return m


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _scatter(
    jacobian: Array, columns: Index, m: int, hessian: Array, g: Array, information: Array,
    slope: Array,
) -> None:
    for i in range(m):
        slope[columns[i]] += (jacobian[0, i] * g[0] + jacobian[1, i] * g[1]
                              + jacobian[2, i] * g[2]) / DILUTION
        h0 = (jacobian[0, i] * hessian[0, 0] + jacobian[1, i] * hessian[1, 0]
              + jacobian[2, i] * hessian[2, 0]) / DILUTION
        h1 = (jacobian[0, i] * hessian[0, 1] + jacobian[1, i] * hessian[1, 1]
              + jacobian[2, i] * hessian[2, 1]) / DILUTION
        h2 = (jacobian[0, i] * hessian[0, 2] + jacobian[1, i] * hessian[1, 2]
              + jacobian[2, i] * hessian[2, 2]) / DILUTION
        for j in range(m):
            information[columns[i], columns[j]] += (
                h0 * jacobian[0, j] + h1 * jacobian[1, j] + h2 * jacobian[2, j])


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def add_prior(
    knots: Array, first: int, last: int, start: int, stencil: Array, weight: Array, tail: float,
    information: Array, slope: Array,
) -> None:
    """
    Add the prior that finite differences of the coefficients are small, but across start.

    Beyond `tail` standard deviations it gives way (Cauchy): brakes that bite, or a vehicle that
    has come to its stop, are rare and hard jerks.
    """
    width = len(stencil)
    for k in range(max(first - width + 1, 0), last - width + 1):
        if k < start < k + width:
            continue
        for d in range(3):
            e = 0.0
            for i in range(width):
                e += stencil[i] * knots[k + i, d]
            w = weight[d] / (1.0 + weight[d] * e * e / tail ** 2)
            for i in range(width):
                row = 3 * (k + i - first) + d
                if row < 0:
                    continue
                slope[row] += w * stencil[i] * e
                for j in range(width):
                    column = 3 * (k + j - first) + d
                    if column >= 0:
                        information[row, column] += w * stencil[i] * stencil[j]
