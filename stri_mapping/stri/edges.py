# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Reflectance edges: where a flat face changes its brightness, the way along it is told.

The paper names them as what range alone leaves out.  An edge becomes a surfel whose normal lies
along the face, from dark to bright, so that pairs of keyframes compare edges as they compare
lines, and a bright strip's left edge is not taken for its right one.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.surfel import NORMAL_VAR, NX, NY, PULL, X, Y

Array = NDArray[np.float64]

EDGES = 256                # of a keyframe, at most
FARTHEST = 15.0            # metres; beyond, a footprint is as wide as what is looked at
FACING = 0.5               # cosine of incidence: beyond 60 degrees footprints are long
REACH = 0.3                # metres of the face to either side, of which the outer half is a level
NEAR = 0.1                 # metres from a point within which its edge counts
EVEN = 4                   # points of a level, at the least
CONTRAST = 0.15            # difference of the levels over the brighter one, at the least
STEADY = 0.2               # scatter within either level over their difference, at the most
ON_FACE = 0.05             # metres off the line within which points are on the face


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def find_edge(
    xy: Array, lone: Array, brightness: Array, low: int, high: int, line: Array, edge: Array,
) -> bool:
    """
    Write the edge near the foot of a surfel, if there is one.

    Where brightness steps from one level to another, blurred by footprints however wide, its
    integral over the face tells where the step is.

    Parameters
    ----------
    xy, lone, brightness
        (n, 2) points sorted by bearing, whether they are lone, and (n,) what came back of the
        light, in any unit, NaN where it is not known.
    low, high
        Index range of the points around.
    line
        (SURFEL,) of the point on a straight line.
    edge
        (SURFEL,) written, but for bearing and label.

    Returns
    -------
    bool
        Whether there is one.

    """
    x, y, nx, ny = line[X], line[Y], line[NX], line[NY]
    r = math.hypot(x, y)
    if r > FARTHEST or abs(nx * x + ny * y) < FACING * r:
        return False
    count, total, squares = np.zeros(2), np.zeros(2), np.zeros(2)
    first = last = before = np.nan
    integral = 0.0
    for j in range(low, high):
        dx, dy, v = xy[j, 0] - x, xy[j, 1] - y, brightness[j]
        t = nx * dy - ny * dx
        if (lone[j] != 0.0 or not math.isfinite(v) or abs(t) > REACH
                or abs(nx * dx + ny * dy) > ON_FACE):
            continue
        if math.isnan(first):
            first = t
        else:
            integral += 0.5 * (v + before) * (t - last)
        last, before = t, v
        if abs(t) > 0.5 * REACH:
            side = int(t > 0.0)
            count[side] += 1.0
            total[side] += v
            squares[side] += v * v
    if count.min() < EVEN:
        return False
    levels = total / count
    step = levels[1] - levels[0]
    scatter = math.sqrt(max((squares / count - levels * levels).max(), 0.0))
    if abs(step) <= CONTRAST * levels.max() or scatter > STEADY * abs(step):
        return False
    begin, end = (levels[0], levels[1]) if first < last else (levels[1], levels[0])
    at = (integral - end * last + begin * first) / (begin - end)
    if abs(at) > NEAR:
        return False
    sign = 1.0 if step > 0.0 else -1.0
    edge[X], edge[Y] = x - at * ny, y + at * nx
    edge[NX], edge[NY] = -sign * ny, sign * nx
    edge[NORMAL_VAR], edge[PULL] = line[NORMAL_VAR], 0.0
    return True
