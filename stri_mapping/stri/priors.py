# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What is known of a vehicle's motion before anything is seen: it is smooth, and it rolls."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TAIL = 2.0                # standard deviations beyond which the unusual is taken as it comes
THIRD, SECOND = np.array([-1.0, 3.0, -3.0, 1.0]), np.array([1.0, -2.0, 1.0])
FIRST = np.array([-1.0, 1.0])


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def add_differences(
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


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def add_slip(
    knots: Array, h: float, first: int, last: int, start: int, forward: Array, slip: Array,
    information: Array, slope: Array,
) -> None:
    """
    Add the prior that wheels roll where they point: base_link does not go sideways.

    With e the sideways speed at a knot and w the turn rate, e ~ N(0, s^2 + (a w)^2), with
    Cauchy's tail as for jerks; nothing is said across start.

    Parameters
    ----------
    knots, h, first, last, start
        See `smoother.solve`.
    forward
        (2,) base_link's x axis in the scanner frame.
    slip
        (3,) metres that the scanner is ahead of base_link; s in m/s, infinite for what can go
        sideways; a in metres, by which the axle that does not slip may be off base_link.
    information, slope
        (3 n, 3 n) and (3 n,) added to.

    """
    ahead, sigma, arm = slip
    row = np.zeros((3, 3))
    rate = 0.5 / h
    for k in range(max(first - 1, 1), last - 1):
        if k - 1 < start < k + 2:
            continue
        yaw = (knots[k - 1, 2] + 4.0 * knots[k, 2] + knots[k + 1, 2]) / 6.0
        cos, sin = math.cos(yaw), math.sin(yaw)
        fx, fy = cos * forward[0] - sin * forward[1], sin * forward[0] + cos * forward[1]
        vx, vy, turn = rate * (knots[k + 1] - knots[k - 1])
        e = -fy * vx + fx * vy - ahead * turn
        weight = 1.0 / (sigma ** 2 + (arm * turn) ** 2)
        weight /= 1.0 + weight * e * e / TAIL ** 2
        speed = fx * vx + fy * vy
        row[2, 0], row[2, 1] = -fy * rate, fx * rate
        row[0, 0], row[0, 1] = -row[2, 0], -row[2, 1]
        row[0, 2], row[1, 2], row[2, 2] = (
            -speed / 6.0 + ahead * rate, -speed * 4.0 / 6.0, -speed / 6.0 - ahead * rate)
        for i in range(max(first - k + 1, 0), 3):
            at = 3 * (k - 1 + i - first)
            for d in range(3):
                slope[at + d] += weight * row[i, d] * e
                for j in range(max(first - k + 1, 0), 3):
                    to = 3 * (k - 1 + j - first)
                    for c in range(3):
                        information[at + d, to + c] += weight * row[i, d] * row[j, c]
