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
AROUND = np.arange(-2.0, 2.01) / 3.0     # grid intervals tried about the best, then finer
REFINEMENTS = 4

Profile = tuple[float, Array, Array]     # seconds, bearings (n,), ranges (n,) NaN where none


class SlopeSearch:
    """
    Candidates of a constant twist of base_link, judged as scan after scan comes.

    Parameters
    ----------
    mount
        (3,) planar pose of the scanner in base_link.
    speeds, turn_rates
        Candidates in m/s along base_link's x axis and rad/s, evenly spaced; the best is refined
        between them.
    every
        Seconds between scans that later ones are predicted from.
    lags
        Seconds after which, at the least.
    acceleration, until
        In m/s^2 along x, of all candidates, and the time in seconds at which they have their
        speed.

    """

    def __init__(
        self, mount: Array, speeds: Array = SPEEDS, turn_rates: Array = TURN_RATES,
        every: float = 0.08, lags: tuple[float, ...] = LAGS, acceleration: float = 0.0,
        until: float = 0.0,
    ) -> None:
        """Start with no scan."""
        self.acceleration, self._until = acceleration, until
        self._mount, self._every, self._lags = mount, every, lags
        self._speeds, self._turn_rates = speeds, turn_rates
        self._total = np.zeros((len(speeds), len(turn_rates)))
        self._weight = np.zeros_like(self._total)
        self._profiles: list[Profile] = []
        self._pairs: list[tuple[int, int]] = []
        self._anchors: list[int] = []            # scans that later ones are predicted from
        self._next = [0] * len(lags)             # anchor due next, for each lag

    def add(self, profile: Profile) -> None:
        """
        Predict a scan from earlier ones by every candidate.

        Parameters
        ----------
        profile
            Time, bearings (rising, evenly spaced, planar scanner frame) and ranges of the scan.

        """
        t, bearings, ranges = profile
        if len(bearings) < 2:                   # a scan may come without rays
            return
        k = len(self._profiles)
        self._profiles.append((t, bearings, np.where(ranges < FAR, ranges, np.nan)))
        for i in self._due(t):
            self._pairs.append((i, k))
            self._compare([(i, k)], self._speeds, self._turn_rates, 3, self._total, self._weight)
        if not self._anchors or t >= self._profiles[self._anchors[-1]][0] + self._every:
            self._anchors.append(k)

    def _due(self, t: float) -> list[int]:
        """Return the anchors from which a scan at a time is to be predicted."""
        found = set()
        for n, lag in enumerate(self._lags):
            begin = self._next[n]
            while (self._next[n] < len(self._anchors)
                    and self._profiles[self._anchors[self._next[n]]][0] + lag <= t):
                self._next[n] += 1
            if self._next[n] > begin:
                found.add(self._anchors[self._next[n] - 1])
        return sorted(found)

    def coarse_cost(self) -> float:
        """Return the cost, as `best` has it, of the best candidate before it is refined."""
        return _least(_mean(self._total, self._weight), self._speeds, self._turn_rates)[2]

    def best(self) -> tuple[Array, float]:
        """
        Refine the best candidate.

        Returns
        -------
        twist : Array
            (3,) speed, 0, turn rate.
        cost : float
            Mean capped difference of ranges in metres at that twist; `CAP` where nothing
            overlaps.

        """
        costs = _mean(self._total, self._weight)
        speed, turn, cost = _least(costs, self._speeds, self._turn_rates)
        by_speed, by_turn = _spacing(self._speeds), _spacing(self._turn_rates)
        for level in range(REFINEMENTS):
            finer = AROUND * 0.4 ** level
            speeds, turns = speed + finer * by_speed, turn + finer * by_turn
            speed, turn, cost = _least(self._costs(speeds, turns), speeds, turns)
        return np.array([speed, 0.0, turn]), cost

    def cost_of(self, twist: Array) -> float:
        """Return the cost, as `best` has it, of one twist (3,) of base_link."""
        return float(self._costs(twist[:1], twist[2:])[0, 0])

    def _costs(self, speeds: Array, turn_rates: Array) -> Array:
        total = np.zeros((len(speeds), len(turn_rates)))
        weight = np.zeros_like(total)
        self._compare(self._pairs, speeds, turn_rates, 1, total, weight)
        return _mean(total, weight)

    def _compare(
        self, pairs: list[tuple[int, int]], speeds: Array, turn_rates: Array, every: int,
        total: Array, weight: Array,
    ) -> None:
        for i, k in pairs:
            (t, bearings, ranges), (later, there, then) = self._profiles[i], self._profiles[k]
            mean = speeds + self.acceleration * (0.5 * (t + later) - self._until)
            _predict(ranges, bearings[0], then, there[0], bearings[1] - bearings[0], later - t,
                     self._mount, mean, turn_rates, k % every, every, total, weight)


def _spacing(values: Array) -> float:
    return float(values[1] - values[0]) if len(values) > 1 else 0.0


def _least(costs: Array, speeds: Array, turn_rates: Array) -> tuple[float, float, float]:
    """Return the best speed and turn rate and their cost; rather slow where nothing decides."""
    costs = costs + (1e-5 * np.abs(speeds)[:, None] + 1e-5 * np.abs(turn_rates))
    v, w = np.unravel_index(int(np.argmin(costs)), costs.shape)
    return float(speeds[v]), float(turn_rates[w]), float(costs[v, w])


def _mean(total: Array, weight: Array) -> Array:
    """Return mean differences; a motion that leaves little to compare must not win by that."""
    missing = np.maximum(0.0, 0.5 * weight.max() - weight)
    return np.asarray((total + CAP * missing + CAP * 1e-9) / (weight + missing + 1e-9))


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _predict(
    ranges: Array, first: float, later: Array, later_first: float, step: float, dt: float,
    mount: Array, speeds: Array, turn_rates: Array, begin: int, every: int, total: Array,
    weight: Array,
) -> None:
    """Add the capped range differences of a later scan, and their counts (speeds, turn rates)."""
    cm, sm = math.cos(mount[2]), math.sin(mount[2])
    for j in range(begin, len(ranges), every):
        r = ranges[j]
        if not math.isfinite(r):
            continue
        a = first + step * j + mount[2]
        # the point in base_link at the time of the earlier scan
        x, y = mount[0] + r * math.cos(a), mount[1] + r * math.sin(a)
        for w in range(len(turn_rates)):
            half = 0.5 * turn_rates[w] * dt
            chord = math.sin(half) / half if abs(half) > 1e-9 else 1.0
            c, s = math.cos(2.0 * half), math.sin(2.0 * half)
            ux, uy = chord * math.cos(half) * dt, chord * math.sin(half) * dt
            for v in range(len(speeds)):
                # in base_link at the time of the later scan, then from the scanner
                dx, dy = x - speeds[v] * ux, y - speeds[v] * uy
                bx, by = c * dx + s * dy - mount[0], -s * dx + c * dy - mount[1]
                lx, ly = cm * bx + sm * by, -sm * bx + cm * by
                u = (math.atan2(ly, lx) - later_first) / step
                if 0.0 < u < len(later) - 1:
                    near, far = later[int(u)], later[int(u) + 1]
                    total[v, w] += _difference(math.hypot(lx, ly), near, far)
                    weight[v, w] += 1.0


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
