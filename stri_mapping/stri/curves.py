# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps 2 and 3 of the paper over time: edges followed from scan to scan draw curves.

What stands still draws, in the frame of the moving vehicle, a curve p(t) whose slope is the
vehicle's motion: p' = -v - w x p.  (The paper's eq. 3 is the component along the street, with
the range image's rows as the unit of time.)  Each curve is smoothed by a local polynomial, so
that its position and slope at any moment come with their uncertainty.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

CURVES, SAMPLES = 256, 192
GATE = 0.30          # metres from the predicted place within which an edge continues a curve
MIN_SAMPLES = 6      # of a window, for a polynomial of three coefficients
MIN_SIGMA = 0.006    # metres; a fit cannot be better than quantisation allows


class Curves:
    """
    The curves in view, each a ring of samples (t, x, y) in the base frame at the ray's time.

    Times are seconds from an origin that the caller chooses.
    """

    def __init__(self) -> None:
        """Start with no curve."""
        self.samples = np.empty((CURVES, SAMPLES, 3))
        self.count = np.zeros(CURVES, dtype=np.int64)
        self.side = np.zeros(CURVES, dtype=np.int8)

    def follow(
        self, times: Array, points: Array, sides: NDArray[np.int8], twist: Array,
        patience: float,
    ) -> None:
        """
        Continue the curves with the edges of a new scan, begin new ones, end the stale.

        Parameters
        ----------
        times
            (n,) seconds of the edges' rays.
        points
            (n, 2) edges in the base frame at their times, metres.
        sides
            (n,) which end of its surface each edge is.
        twist
            (3,) vx, vy, wz of base_link by which the curves are predicted.
        patience
            Seconds without a sample after which a curve has ended.

        """
        _follow(self.samples, self.count, self.side, times, points, sides, twist, patience)

    def slopes(self, moment: float, begin: float, end: float) -> tuple[Array, Array]:
        """
        Smooth every curve over a window and differentiate it.

        Parameters
        ----------
        moment
            Time at which to evaluate, seconds.
        begin, end
            Window of the samples used.

        Returns
        -------
        states : Array
            (m, 4) x, y, x', y' of the curves that have enough samples around the moment.
        sigmas : Array
            (m, 2) standard deviations of x' and y' in m/s.

        """
        states, sigmas = np.empty((CURVES, 4)), np.empty((CURVES, 2))
        m = _slopes(self.samples, self.count, moment, begin, end, states, sigmas)
        return states[:m], sigmas[:m]


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _follow(
    samples: Array, count: Counts, side: NDArray[np.int8], times: Array, points: Array,
    sides: NDArray[np.int8], twist: Array, patience: float,
) -> None:
    for i in range(len(times)):
        t, x, y = times[i], points[i, 0], points[i, 1]
        best, nearest, free = -1, GATE, -1
        for c in range(CURVES):
            last = samples[c, (count[c] - 1) % SAMPLES]
            if count[c] == 0 or t - last[0] > patience:
                count[c] = 0
                free = c if free < 0 else free
                continue
            if side[c] != sides[i] or last[0] >= t:
                continue
            dt = t - last[0]
            dx = last[1] - dt * (twist[0] - twist[2] * last[2]) - x
            dy = last[2] - dt * (twist[1] + twist[2] * last[1]) - y
            distance = np.hypot(dx, dy)
            if distance < nearest:
                best, nearest = c, distance
        if best < 0:
            if free < 0:
                continue
            best = free
            side[best] = sides[i]
        k = count[best] % SAMPLES
        samples[best, k, 0], samples[best, k, 1], samples[best, k, 2] = t, x, y
        count[best] += 1


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _slopes(
    samples: Array, count: Counts, moment: float, begin: float, end: float, states: Array,
    sigmas: Array,
) -> int:
    m = 0
    half = 0.5 * (end - begin)
    powers, rhs = np.empty((3, 3)), np.empty((3, 2))
    for c in range(CURVES):
        powers[:], rhs[:] = 0.0, 0.0
        first, last, n = np.inf, -np.inf, 0
        for k in range(min(count[c], SAMPLES)):
            t = samples[c, k, 0]
            if t < begin or t > end:
                continue
            u = (t - moment) / half
            n += 1
            first, last = min(first, t), max(last, t)
            for i in range(3):
                for j in range(3):
                    powers[i, j] += u ** (i + j)
                rhs[i, 0] += u ** i * samples[c, k, 1]
                rhs[i, 1] += u ** i * samples[c, k, 2]
        if n < MIN_SAMPLES or last - first < 0.5 * half or not first <= moment <= last + 0.1 * half:
            continue
        inverse = np.linalg.inv(powers)
        fit = inverse @ rhs
        for axis in range(2):
            residual = 0.0
            for k in range(min(count[c], SAMPLES)):
                u = (samples[c, k, 0] - moment) / half
                if begin <= samples[c, k, 0] <= end:
                    residual += (samples[c, k, 1 + axis] - fit[0, axis] - u * fit[1, axis]
                                 - u * u * fit[2, axis]) ** 2
            variance = max(residual / (n - 3), MIN_SIGMA ** 2)
            states[m, axis] = fit[0, axis]
            states[m, 2 + axis] = fit[1, axis] / half
            sigmas[m, axis] = np.sqrt(variance * inverse[1, 1]) / half
        m += 1
    return m
