# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The slope idea, for the start and after losing track: the motion that continues the image.

The range profile of a later scan is predicted from an earlier one for every speed and turn rate
that a vehicle may have; the motion that predicts best is taken.  Unlike matching of nearest
neighbours this does not prefer "nothing moved": a wall met by the same bearings again and again
agrees with every speed, and only what stands out of it decides.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FAR = 30.0           # metres; beyond, a ray's footprint is wider than what is to be seen
CAP = 0.25           # metres beyond which a difference of ranges says "something else"
LAGS = (0.1, 0.25, 0.45)
SPEEDS = np.arange(-20.0, 20.01, 0.2)
TURN_RATES = np.deg2rad(np.arange(-60.0, 60.01, 10.0))
REFINE = 10          # times finer around the best

Profile = tuple[float, Array, Array]     # seconds, bearings (n,), ranges (n,) NaN where none


def propose(
    profiles: Sequence[Profile], mount: Array, speeds: Array = SPEEDS,
    turn_rates: Array = TURN_RATES,
) -> tuple[Array, float]:
    """
    Return the constant twist of base_link that best predicts each profile from earlier ones.

    Parameters
    ----------
    profiles
        Time, bearings (rising, evenly spaced, planar scanner frame) and ranges of each scan,
        oldest first.
    mount
        (3,) planar pose of the scanner in base_link.
    speeds, turn_rates
        Candidates in m/s along base_link's x axis and rad/s; the best is refined between them.

    Returns
    -------
    twist : Array
        (3,) speed, 0, turn rate.
    cost : float
        Mean capped difference of ranges in metres at that twist; `CAP` where nothing overlaps.

    """
    profiles = [p for p in profiles if len(p[1]) > 1]       # a scan may come without rays
    if len(profiles) < 2:
        return np.zeros(3), CAP
    ranges = np.full((len(profiles), max(len(r) for _, _, r in profiles)), np.nan)
    for row, (_, _, r) in zip(ranges, profiles):
        row[:len(r)] = np.where(r < FAR, r, np.nan)
    times = np.array([t for t, _, _ in profiles])
    first = np.array([b[0] for _, b, _ in profiles])
    step = float(profiles[0][1][1] - profiles[0][1][0])
    pairs = _pairs(times)
    speed, turn = 0.0, 0.0
    fine_speeds, fine_turns = speeds, turn_rates
    for every in (3, 1):
        costs = _costs(ranges, first, step, times, pairs, mount, fine_speeds, fine_turns,
                       every)
        # where nothing decides, rather slow than fast
        costs += 1e-5 * np.abs(fine_speeds)[:, None] + 1e-5 * np.abs(fine_turns)
        best, cost = np.unravel_index(int(np.argmin(costs)), costs.shape), float(costs.min())
        speed, turn = float(fine_speeds[best[0]]), float(fine_turns[best[1]])
        around = np.linspace(-1.0, 1.0, 2 * REFINE + 1)
        fine_speeds = speed + around * _spacing(speeds)
        fine_turns = turn + around * _spacing(turn_rates)
    return np.array([speed, 0.0, turn]), cost


def cost_of(profiles: Sequence[Profile], mount: Array, twist: Array) -> float:
    """Return the cost, as `propose` has it, of one twist (3,) of base_link."""
    _, cost = propose(profiles, mount, twist[:1], twist[2:])
    return cost


def _spacing(values: Array) -> float:
    return float(values[1] - values[0]) if len(values) > 1 else 0.0


def _pairs(times: Array) -> NDArray[np.int64]:
    """Return (m, 2) indices of scans to compare: lags in seconds, or the scans' own period."""
    found = []
    for i in range(0, len(times), 1 + len(times) // 8):
        for lag in LAGS:
            k = int(np.searchsorted(times, times[i] + lag))
            if i < k < len(times) and (i, k) not in found:
                found.append((i, k))
    return np.array(found, dtype=np.int64).reshape(-1, 2)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _costs(
    ranges: Array, first: Array, step: float, times: Array, pairs: NDArray[np.int64],
    mount: Array, speeds: Array, turn_rates: Array, every: int,
) -> Array:
    """Return the mean capped range differences (speeds, turn rates)."""
    rays = ranges.shape[1]
    total = np.zeros((len(speeds), len(turn_rates)))
    weight = np.full((len(speeds), len(turn_rates)), 1e-9)
    cm, sm = math.cos(mount[2]), math.sin(mount[2])
    for p in range(len(pairs)):
        i, k = pairs[p]
        dt = times[k] - times[i]
        for j in range(p % every, rays, every):
            r = ranges[i, j]
            if not math.isfinite(r):
                continue
            a = first[i] + step * j + mount[2]
            # the point in base_link at the time of scan i
            x, y = mount[0] + r * math.cos(a), mount[1] + r * math.sin(a)
            for w in range(len(turn_rates)):
                half = 0.5 * turn_rates[w] * dt
                chord = math.sin(half) / half if abs(half) > 1e-9 else 1.0
                c, s = math.cos(2.0 * half), math.sin(2.0 * half)
                ux, uy = chord * math.cos(half) * dt, chord * math.sin(half) * dt
                for v in range(len(speeds)):
                    # in base_link at the time of scan k, then from the scanner
                    dx, dy = x - speeds[v] * ux, y - speeds[v] * uy
                    bx, by = c * dx + s * dy - mount[0], -s * dx + c * dy - mount[1]
                    lx, ly = cm * bx + sm * by, -sm * bx + cm * by
                    u = (math.atan2(ly, lx) - first[k]) / step
                    if 0.0 < u < rays - 1:
                        near, far = ranges[k, int(u)], ranges[k, int(u) + 1]
                        total[v, w] += _difference(math.hypot(lx, ly), near, far)
                        weight[v, w] += 1.0
    # a motion that leaves little to compare must not win by that
    enough = 0.5 * weight.max()
    for v in range(len(speeds)):
        for w in range(len(turn_rates)):
            missing = max(0.0, enough - weight[v, w])
            total[v, w] = (total[v, w] + CAP * missing) / (weight[v, w] + missing)
    return total


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _difference(r: float, a: float, b: float) -> float:
    """
    Return how far a range is from the two rays around it, between them counting as on.

    Far along a wall ranges differ by metres from ray to ray; comparing with the nearer of the
    two there would prefer the speed at which all rays meet themselves: none.
    """
    if min(a, b) <= r <= max(a, b):
        return 0.0
    d = min(abs(a - r), abs(b - r))
    return min(d, CAP) if math.isfinite(d) else CAP
