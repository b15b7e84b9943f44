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
from stri_mapping.stri.priors import add_differences, add_slip, FIRST, SECOND, TAIL, THIRD
from stri_mapping.stri.spline import pose_at

Array = NDArray[np.float64]
Index = NDArray[np.int64]

RESIDUALS = 100   # of a pair, about: more of one keyframe tell little new
MOVED, TURNED = 0.003, 0.0007     # metres, radians: beyond, a pair is linearised again
STOP = 2e-4                       # metres or radians: the fit has converged
ANCHOR, LOOSE = 1e8, 1e2      # information, 1/m^2 or 1/rad^2, on a fixed place and on a rough one
VOTES = 1.2        # seconds between keyframes whose comparison tells what moves


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def solve(
    knots: Array, h: float, first: int, last: int, start: int, ends: Index, z: Array,
    hessian: Array, gradient: Array, passes: Index, time: Array, pose: Array, surfels: Array,
    counts: Index, bins: NDArray[np.int32], scales: Array, newest: float, begun: int,
    iterations: int, jerk: Array, acceleration: Array, straight: Array, slip: Array,
    pull: float, trust: Array, forward: Array, votes: Array, dilution: float,
) -> None:
    """
    Fit knots first .. last - 1 by Gauss-Newton; earlier ones stay as they are.

    Parameters
    ----------
    knots, h
        (k, 3) spline coefficients, changed in place, and knot spacing in seconds.
    start
        Knot at which the motion was taken up: no prior ties it to the motion before.  While it is
        active, it is held in its place: knot 0 firmly, any other only where no pair tells it.
    ends .. passes
        The pairs in use, see `window.Pairs`.
    time .. bins
        The keyframes, see `window.Keyframes`; `pose` is brought up to date.
    scales
        Geman-McClure scales of the iterations, the last for all that follow.
    newest
        Pairs with a keyframe at or after this time anneal by `scales`.
    begun, iterations
        Iterations done before, by another call, and how many there are to be at the most.
    jerk, acceleration, straight
        (3,) prior information of third, second and first differences of the coefficients.
    slip
        See `priors.add_slip`.
    pull, trust, forward, votes
        See `pairs.linearise`; neighbours in time among the newest pairs vote.
    dilution
        Residuals that count as one.

    """
    n = last - first
    information, slope = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    for i in range(begun, iterations):
        information[:], slope[:] = 0.0, 0.0
        scale, final = scales[min(i, len(scales) - 1)], scales[-1]
        _add_pairs(
            knots, h, first, ends, z, hessian, gradient, passes, time, pose, surfels, counts,
            bins, scale, final, len(scales) - 1, newest, pull, trust, forward, votes,
            dilution, information, slope)
        add_differences(knots, first, last, start, THIRD, jerk, TAIL, information, slope)
        add_differences(knots, first, last, start, FIRST, straight, np.inf, information, slope)
        add_differences(
            knots, first, last, start, SECOND, acceleration, np.inf, information, slope)
        add_slip(knots, h, first, last, start, forward, slip, information, slope)
        for d in range(3 * n):
            information[d, d] += 1e-6
        if start >= first:
            for d in range(9):
                row = 3 * (start - first) + d
                information[row, row] += ANCHOR if d < 3 and start == 0 else LOOSE
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
    bins: NDArray[np.int32], scale: float, final: float, annealed: int, newest: float,
    pull: float, trust: Array, forward: Array, votes: Array, dilution: float, information: Array,
    slope: Array,
) -> None:
    weights_a, weights_b = np.empty(4), np.empty(4)
    now, shift, g = np.empty(3), np.empty(3), np.empty(3)
    blocks = np.empty((5, 3, 3))
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
        if passes[p] == 0 or moved or turned or (new and passes[p] < annealed):
            stride = max(1, counts[a] // RESIDUALS)
            comparisons = votes[-1]
            linearise(
                surfels[a], counts[a], surfels[b], counts[b], bins[b], now,
                scale if new else final, (a + b) % stride, stride, pull, trust,
                forward if time[a] >= newest and 0.0 < time[a] - time[b] < VOTES else still,
                hessian[p], gradient[p], votes)
            if a >= len(time) // 2:     # edges are heard with the lines they lie on
                votes[-1] = comparisons
            z[p] = now
            passes[p] += 1
        for d in range(3):
            shift[d] = now[d] - z[p, d]
        for d in range(3):
            g[d] = (gradient[p, d] + hessian[p, d, 0] * shift[0] + hessian[p, d, 1] * shift[1]
                    + hessian[p, d, 2] * shift[2])
        add_pair(ka - first, kb - first, weights_a, weights_b, pose[b], now, hessian[p], g,
                 1.0 / dilution, blocks, information, slope)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def add_pair(
    ka: int, kb: int, weights_a: Array, weights_b: Array, pose_b: Array, z: Array,
    hessian: Array, gradient: Array, factor: float, blocks: Array, information: Array,
    slope: Array,
) -> None:
    """
    Add what a pair tells of its relative pose to the coefficients of both ends.

    Parameters
    ----------
    ka, kb
        Row, in knots, of the first coefficient of either end; rows below zero are fixed.
    weights_a, weights_b
        (4,) of the coefficients.
    pose_b, z
        (3,) of keyframe b, and of a in it.
    hessian, gradient
        (3, 3), (3,) in z.
    factor
        By which both are multiplied.
    blocks
        (5, 3, 3) scratch.
    information, slope
        (3 n, 3 n), (3 n,) added to.

    """
    cos, sin = math.cos(pose_b[2]), math.sin(pose_b[2])
    to_a, to_b = blocks[3], blocks[4]         # dz by the poses of a and of b
    to_a[0, 0], to_a[0, 1], to_a[0, 2] = cos, sin, 0.0
    to_a[1, 0], to_a[1, 1], to_a[1, 2] = -sin, cos, 0.0
    to_a[2, 0], to_a[2, 1], to_a[2, 2] = 0.0, 0.0, 1.0
    to_b[0, 0], to_b[0, 1], to_b[0, 2] = -cos, -sin, z[1]
    to_b[1, 0], to_b[1, 1], to_b[1, 2] = sin, -cos, -z[0]
    to_b[2, 0], to_b[2, 1], to_b[2, 2] = 0.0, 0.0, -1.0
    product(to_a, hessian, to_a, factor, blocks[0])
    product(to_b, hessian, to_b, factor, blocks[1])
    product(to_a, hessian, to_b, factor, blocks[2])
    for i in range(4):
        row_a, row_b = 3 * (ka + i), 3 * (kb + i)
        for d in range(3):
            if row_a >= 0:
                slope[row_a + d] += weights_a[i] * factor * (
                    to_a[0, d] * gradient[0] + to_a[1, d] * gradient[1] + to_a[2, d] * gradient[2])
            if row_b >= 0:
                slope[row_b + d] += weights_b[i] * factor * (
                    to_b[0, d] * gradient[0] + to_b[1, d] * gradient[1] + to_b[2, d] * gradient[2])
        for j in range(4):
            column_a, column_b = 3 * (ka + j), 3 * (kb + j)
            if row_a >= 0 and column_a >= 0:
                _add_block(weights_a[i] * weights_a[j], blocks[0], row_a, column_a, information)
            if row_b >= 0 and column_b >= 0:
                _add_block(weights_b[i] * weights_b[j], blocks[1], row_b, column_b, information)
            if row_a >= 0 and column_b >= 0:
                w = weights_a[i] * weights_b[j]
                for d in range(3):
                    for e in range(3):
                        information[row_a + d, column_b + e] += w * blocks[2, d, e]
                        information[column_b + e, row_a + d] += w * blocks[2, d, e]


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _add_block(w: float, block: Array, row: int, column: int, information: Array) -> None:
    for d in range(3):
        for e in range(3):
            information[row + d, column + e] += w * block[d, e]


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def product(left: Array, middle: Array, right: Array, factor: float, out: Array) -> None:
    """Write factor left' middle right, all (3, 3)."""
    for c in range(3):
        m0 = factor * (middle[0, 0] * right[0, c] + middle[0, 1] * right[1, c]
                       + middle[0, 2] * right[2, c])
        m1 = factor * (middle[1, 0] * right[0, c] + middle[1, 1] * right[1, c]
                       + middle[1, 2] * right[2, c])
        m2 = factor * (middle[2, 0] * right[0, c] + middle[2, 1] * right[1, c]
                       + middle[2, 2] * right[2, c])
        for r in range(3):
            out[r, c] = left[0, r] * m0 + left[1, r] * m1 + left[2, r] * m2
