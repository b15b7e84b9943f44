# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The path as a uniform cubic B-spline of planar poses (x, y, yaw), continuous to acceleration.

Knot k's basis is centred on time ``(k - 1) * h`` of the spline's own clock; the pose at time t
depends on coefficients k .. k + 3 with ``k = floor(t / h)``.  The yaw is not wrapped.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def basis(u: float, out: Array) -> None:
    """Write the four weights at fraction u in [0, 1) of a knot interval."""
    w = 1.0 - u
    out[0] = w * w * w / 6.0
    out[1] = (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0
    out[2] = (-3.0 * u * u * u + 3.0 * u * u + 3.0 * u + 1.0) / 6.0
    out[3] = u * u * u / 6.0


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def slopes(u: float, h: float, out: Array) -> None:
    """Write the four weights of the derivative at fraction u of a knot interval."""
    first, last = 0.5 * (1.0 - u) ** 2, 0.5 * u * u
    middle = 1.0 - first - last
    out[0], out[1] = -first / h, (first - middle) / h
    out[2], out[3] = (middle - last) / h, last / h


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def pose_at(knots: Array, h: float, t: float, weights: Array, pose: Array) -> int:
    """Write the pose at time t and its four weights; return the first knot's index."""
    k = int(math.floor(t / h))
    basis(t / h - k, weights)
    for d in range(3):
        pose[d] = (weights[0] * knots[k, d] + weights[1] * knots[k + 1, d]
                   + weights[2] * knots[k + 2, d] + weights[3] * knots[k + 3, d])
    return k


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def velocity_at(knots: Array, h: float, t: float, out: Array) -> None:
    """Write the derivative of the pose at time t, in the spline's frame."""
    k = int(math.floor(t / h))
    weights = np.empty(4)
    slopes(t / h - k, h, weights)
    for d in range(3):
        out[d] = (weights[0] * knots[k, d] + weights[1] * knots[k + 1, d]
                  + weights[2] * knots[k + 2, d] + weights[3] * knots[k + 3, d])
