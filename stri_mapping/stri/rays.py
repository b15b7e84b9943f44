# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The rays of a scan: which are used, and for what."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# columns of a prepared ray
RANGE, BEARING, TIME, LONE, LABEL, BRIGHTNESS = range(6)
RAY = 6

NOISE = 0.012              # metres, one ray, at zero range; grows by a third every 13 m
NOISE_RANGE = 40.0
GRAZING = 0.2              # metres of range from ray to ray: the footprint's near side is seen
STEP, STEP_PER_RANGE = 0.12, 0.01
ROW = 1.0                  # metres from ray to ray: a wall that is grazed, or columns in a row
LONE_RAY, SIGHT_ONLY, IN_ROW = 1.0, 2.0, 3.0


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def ray_sigma(r: float) -> float:
    """Return the standard deviation of a range in metres."""
    return NOISE * (1.0 + r / NOISE_RANGE)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def prepare_rays(
    ranges: Array, angles: Array, times: Array, labels: NDArray[np.int32], brightness: Array,
    start: float, far: float, out: Array,
) -> int:
    """
    Pick a scan's usable rays; the motion is not needed for this.

    A ray at grazing incidence reports the near side of its footprint, and the last ray before
    a jump a mixture; such a ray serves as a line of sight alone if it is in line with its
    neighbours, else it is kept as a lone one, which may be a column's far side but may not bend
    another ray's line.  In line with its neighbours and metres from them it may be either, as
    columns in a row are: what it is only several turns can tell (`IN_ROW`, see `surfel`).

    Parameters
    ----------
    ranges, angles, times
        (n,) metres (NaN or inf where not valid), radians, seconds since the scan's stamp.
    labels
        (n,) surface numbers.
    brightness
        (n,) what came back of the light, in the device's units; NaN where that is not known.
    start
        Stamp of the scan in seconds.
    far
        Ranges beyond are not used, metres.
    out
        (n, RAY) written with range, bearing, time, lone (0 or `LONE_RAY`, `SIGHT_ONLY`,
        `IN_ROW`), label, brightness.

    Returns
    -------
    int
        Number of rays written.

    """
    n, count = len(ranges), 0
    cos2 = 2.0 * math.cos(angles[1] - angles[0]) if n > 1 else 2.0
    for j in range(n):
        r = ranges[j]
        if not (0.3 < r < far):
            continue
        before = abs(r - ranges[j - 1]) if j > 0 and math.isfinite(ranges[j - 1]) else 1e9
        after = abs(r - ranges[j + 1]) if j + 1 < n and math.isfinite(ranges[j + 1]) else 1e9
        sigma = ray_sigma(r)
        bend = 1e9
        if before < 1e9 and after < 1e9:
            bend = abs(1.0 / ranges[j - 1] - cos2 / r + 1.0 / ranges[j + 1]) * r * r
        lone = 0.0
        if min(before, after) > GRAZING:
            in_line = bend > 1e8 or bend <= 7.2 * sigma + 0.08 * max(before, after)
            lone = LONE_RAY
            if in_line:
                lone = IN_ROW if min(before, after) > ROW else SIGHT_ONLY
        elif bend > 7.2 * sigma:
            step = STEP + STEP_PER_RANGE * r
            if ((1e9 > before > step and ranges[j - 1] > r)
                    or (1e9 > after > step and ranges[j + 1] > r)):
                lone = LONE_RAY
        out[count, RANGE], out[count, BEARING] = r, angles[j]
        out[count, TIME], out[count, LONE] = start + times[j], lone
        out[count, LABEL], out[count, BRIGHTNESS] = labels[j], brightness[j]
        count += 1
    return count
