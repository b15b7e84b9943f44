# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Residuals between two keyframes: point to line, partners found by projection.

The relative pose z = (x, y, yaw) takes surfel coordinates of keyframe a into keyframe b.  Each
surfel of a is looked up at its bearing in b; no search tree is needed.  A pair of keyframes is
condensed to one 3x3 information matrix and gradient in z.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.keyframe import bearing_bin
from stri_mapping.stri.surfel import NORMAL_VAR, NX, NY, PULL, S_BEARING, S_LABEL, X, Y

Array = NDArray[np.float64]

SIGMA = 0.02              # metres, one residual
TANGENT = 0.3             # metres along the line within which a partner counts
TANGENT_PER_SCALE = 2.0
SAME_NORMAL = 0.9         # cosine
FLAT = 0.005              # vote of a surfel that agrees, but would with any speed


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def relative(a: Array, b: Array, z: Array) -> None:
    """Write the pose of a seen from b."""
    dx, dy = a[0] - b[0], a[1] - b[1]
    cos, sin = math.cos(b[2]), math.sin(b[2])
    z[0], z[1], z[2] = cos * dx + sin * dy, -sin * dx + cos * dy, a[2] - b[2]


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def linearise(
    a: Array, count_a: int, b: Array, count_b: int, bins_b: NDArray[np.int32], z: Array,
    scale: float, first: int, stride: int, pull: float, trust: Array, forward: Array,
    hessian: Array, gradient: Array, votes: Array,
) -> None:
    """
    Write information matrix and gradient of the residuals at a relative pose.

    Parameters
    ----------
    a, count_a
        Surfels of the first keyframe and how many there are.
    b, count_b, bins_b
        Surfels of the second, their number and bearing bins.
    z
        (3,) pose of a in b at which to linearise.
    scale
        Geman-McClure scale in metres.
    first, stride
        Every stride-th surfel of a is used, beginning with first.
    pull
        1/m, of slanted footprints, by which surfels are corrected, see `range_error`.
    trust
        (labels,) weight of each surface, by label modulo its length.
    forward
        (2,) direction in the scanner frame in which the vehicle moves; zero: do not vote.
    hessian, gradient
        (3, 3) and (3,) written.
    votes
        (labels + 1,) accepted weight of the surfels that see motion forward, added up by a's
        label; the last counts how often that was done.

    """
    cos, sin = math.cos(z[2]), math.sin(z[2])
    h00 = h01 = h02 = h11 = h12 = h22 = 0.0
    g0 = g1 = g2 = 0.0
    n00 = n01 = n11 = 0.0
    asked = forward[0] ** 2 + forward[1] ** 2
    votes[-1] += asked
    for r in range(first, count_a, stride):
        k, px, py, e, w = _match(a[r], b, count_b, bins_b, z, cos, sin, scale, pull)
        if k < 0:
            continue
        nx, ny = b[k, NX], b[k, NY]
        label = int(a[r, S_LABEL]) % len(trust)
        votes[label] += w * (
            (forward[0] * a[r, NX] + forward[1] * a[r, NY]) ** 2 + FLAT * asked)
        w *= min(trust[label], trust[int(b[k, S_LABEL]) % len(trust)])
        if w == 0.0:
            continue
        w /= SIGMA * SIGMA
        j2 = -nx * py + ny * px
        h00 += w * nx * nx
        h01 += w * nx * ny
        h11 += w * ny * ny
        h02 += w * nx * j2
        h12 += w * ny * j2
        h22 += w * j2 * j2
        g0 += w * nx * e
        g1 += w * ny * e
        g2 += w * j2 * e
        # what the noise of the normals alone would add, along the surface
        q = w * (b[k, NORMAL_VAR] + a[r, NORMAL_VAR])
        n00 += q * ny * ny
        n01 -= q * nx * ny
        n11 += q * nx * nx
    hessian[0, 0], hessian[0, 1], hessian[1, 1] = h00 - n00, h01 - n01, h11 - n11
    hessian[0, 2], hessian[1, 2], hessian[2, 2] = h02, h12, h22
    gradient[0], gradient[1], gradient[2] = g0, g1, g2
    _clamp(hessian, gradient)
    hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def testify(
    a: Array, count_a: int, b: Array, count_b: int, bins_b: NDArray[np.int32], z: Array,
    scale: float, stride: int, pull: float, forward: Array, testimony: Array,
) -> None:
    """
    Add up what each surface of a says of the motion along the way, apart from all others.

    Parameters
    ----------
    a, count_a, b, count_b, bins_b, z, scale, stride, pull, forward
        See `linearise`; z as it was fitted to all surfaces.
    testimony
        (2, labels) information of each surface along the way, in residuals, is added to the
        first row, and that times the metres by which it would have a further ahead to the second.

    """
    cos, sin = math.cos(z[2]), math.sin(z[2])
    for r in range(0, count_a, stride):
        if a[r, S_LABEL] < 0.0:
            continue
        k, _, _, e, w = _match(a[r], b, count_b, bins_b, z, cos, sin, scale, pull)
        if k < 0:
            continue
        label = int(a[r, S_LABEL]) % testimony.shape[1]
        along = forward[0] * b[k, NX] + forward[1] * b[k, NY]
        testimony[0, label] += w * along * along
        testimony[1, label] -= w * along * e


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _match(
    surfel: Array, b: Array, count: int, bins: NDArray[np.int32], z: Array, cos: float,
    sin: float, scale: float, pull: float,
) -> tuple[int, float, float, float, float]:
    """
    Return the surfel of b that a surfel meets, the offset turned into b, residual and weight.

    The surfel is -1 where there is none near; the weight is 0 where it can't be the same face.
    """
    reach = max(TANGENT, TANGENT_PER_SCALE * scale)
    shift = pull * surfel[PULL]
    ax, ay = surfel[X] - shift * surfel[NX], surfel[Y] - shift * surfel[NY]
    px, py = cos * ax - sin * ay, sin * ax + cos * ay
    x, y = px + z[0], py + z[1]
    k = _partner(b, count, bins, x, y, math.hypot(reach, 4.0 * scale))
    e = w = 0.0
    if k >= 0:
        nx, ny = b[k, NX], b[k, NY]
        ex, ey = x - b[k, X], y - b[k, Y]
        e = nx * ex + ny * ey + pull * b[k, PULL]
        facing = ((cos * surfel[NX] - sin * surfel[NY]) * nx
                  + (sin * surfel[NX] + cos * surfel[NY]) * ny)
        if abs(-ny * ex + nx * ey) > reach:
            k = -1
        elif facing >= SAME_NORMAL and abs(e) <= 4.0 * scale:
            w = 1.0 / (1.0 + (e / scale) ** 2) ** 2
    return k, px, py, e, w


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _partner(
    b: Array, count: int, bins: NDArray[np.int32], x: float, y: float, widest: float,
) -> int:
    """
    Return the surfel of b nearest to a point, -1 where none is within a distance.

    From the point's bearing it goes both ways until bearings alone are further apart.
    """
    bearing, r = math.atan2(y, x), math.hypot(x, y)
    middle = bins[bearing_bin(bearing)]
    while middle < count and b[middle, S_BEARING] < bearing:
        middle += 1
    best, nearest, apart = -1, widest * widest, widest / r
    for way in (1, -1):
        k = middle if way > 0 else middle - 1
        while 0 <= k < count and way * (b[k, S_BEARING] - bearing) < apart:
            dx, dy = b[k, X] - x, b[k, Y] - y
            d = dx * dx + dy * dy
            if d < nearest:
                best, nearest, apart = k, d, math.sqrt(d) / r
            k += way
    return best


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _clamp(hessian: Array, gradient: Array) -> None:
    """
    Remove the direction of translation in which there is no more information than noise.

    What is left of the rotation is at least what the rest implies: no direction may come to know
    less than nothing.
    """
    a, b, o = hessian[0, 0], hessian[1, 1], hessian[0, 1]
    p, q = hessian[0, 2], hessian[1, 2]
    mean, spread = 0.5 * (a + b), math.sqrt(0.25 * (a - b) ** 2 + o * o)
    if mean - spread >= 1e-3 * max(mean + spread, 1e-9):
        implied = (b * p * p - 2.0 * o * p * q + a * q * q) / (a * b - o * o)
        hessian[2, 2] = max(hessian[2, 2], implied)
        return
    angle = 0.5 * math.atan2(2.0 * o, a - b)
    nx, ny = math.cos(angle), math.sin(angle)
    strong = max(mean + spread, 0.0)
    hessian[0, 0], hessian[0, 1], hessian[1, 1] = (
        strong * nx * nx, strong * nx * ny, strong * ny * ny)
    cross = p * nx + q * ny
    hessian[0, 2], hessian[1, 2] = cross * nx, cross * ny
    if strong > 0.0:
        hessian[2, 2] = max(hessian[2, 2], cross * cross / strong)
    slope = gradient[0] * nx + gradient[1] * ny
    gradient[0], gradient[1] = slope * nx, slope * ny
