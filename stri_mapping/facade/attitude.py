# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Roll, pitch and heave of the vehicle over time, from what its vertical scans tell.

The state x(t) = (roll, pitch, heave, crossfall, slope, lean) is a uniform cubic B-spline.  Its
knots follow first-order Gauss-Markov processes about zero: the body on its springs, the road's
slope across and along, and how far the walls of the moment are from upright.  Road and walls are
statements linear in the state (`survey`), so that the most likely spline is one linear solve; old
knots are marginalised, never held.  Where nothing is told, all returns to zero: the planar path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.knots import Knots
from stri_mapping.facade.survey import CROSSFALL, Evidence, LEAN, SLOPE, STATE
from stri_mapping.stri.spline import basis

Array = NDArray[np.float64]

# Knot interval, nanoseconds: a tenth of a second bends less than 2 % at the springs' 1.4 Hz.
KNOT_NS = 100_000_000
# Intervals heard after a knot before it is final.
LAG = 3
# Standard deviation and correlation time (s) of each part of the state, radians and metres.
# Roads fall by up to 5 % to a side and 10 % along, and change that by 0.1 degrees in a second.
SIGMA = np.array([*np.deg2rad([1.0, 1.0]), 0.03, *np.deg2rad([1.5, 3.0, 0.1])])
TIME = np.array([0.3, 0.3, 0.3, 850.0, 850.0, 0.5])
# A knot whose roll or pitch is not known better than this, radians, is not observed.
OBSERVED = np.deg2rad(0.2)


@dataclass(frozen=True, eq=False)
class Attitude:
    """
    A finished stretch of the spline; see `stri.spline` for which knots a time depends on.

    Attributes
    ----------
    start_ns
        Time of knot interval 0.
    knots
        (n + 3, 3) roll and pitch in radians, heave in metres, for n intervals.
    sigma
        (n + 3, 2) standard deviations of the knots' roll and pitch.

    """

    start_ns: int
    knots: Array
    sigma: Array

    @property
    def end_ns(self) -> int:
        """Time up to which the stretch is known."""
        return self.start_ns + max(len(self.knots) - 3, 0) * KNOT_NS

    def evaluate(self, stamps_ns: NDArray[np.int64], attitude: Array,
                 told: NDArray[np.bool_]) -> None:
        """
        Write what is known at times within the stretch, and leave the other rows alone.

        Parameters
        ----------
        stamps_ns
            (n,) nanoseconds.
        attitude
            (n, 3) roll and pitch in radians, heave in metres.
        told
            (n, 2) whether road or walls told roll and pitch.

        """
        if len(self.knots) > 3:
            _evaluate(stamps_ns, self.start_ns, self.knots, self.sigma, attitude, told)


@numba.njit(cache=True)
def _evaluate(  # type: ignore[no-untyped-def]
    stamps, start, knots, sigma, attitude, told,
):
    weights, k = np.empty(4), 0
    roll, pitch = False, False
    for i in range(len(stamps)):
        since = stamps[i] - start
        if i == 0 or not 0 <= since - k * KNOT_NS < KNOT_NS:
            k = max(min(since // KNOT_NS, len(knots) - 4), 0)
            roll = max(sigma[k + 1, 0], sigma[k + 2, 0]) < OBSERVED
            pitch = max(sigma[k + 1, 1], sigma[k + 2, 1]) < OBSERVED
        u = (since - k * KNOT_NS) / KNOT_NS
        if not 0.0 <= u <= 1.0:
            continue
        basis(u, weights)
        for m in range(3):
            attitude[i, m] = (weights[0] * knots[k, m] + weights[1] * knots[k + 1, m]
                              + weights[2] * knots[k + 2, m] + weights[3] * knots[k + 3, m])
        told[i, 0], told[i, 1] = roll, pitch


@numba.njit(cache=True)
def _accumulate(  # type: ignore[no-untyped-def]
    since, normal, vector, check, value, scale, rows, knots, doubt, information, right,
):
    """
    Add statements to the normal equations of the four knots (4, 5) of their interval.

    Those far off what the knots predict hardly count (Geman-McClure).  While crossfall and
    slope are in doubt (2, rad), so is what is upright, and walls may be as far off.
    """
    weights = np.empty(4)
    for r in rows:
        basis((since[r] % KNOT_NS) / KNOT_NS, weights)
        off = -value[r]
        for i in range(4):
            for m in range(STATE):
                off += weights[i] * knots[i, m] * check[r, m]
        limit = scale[r]
        if check[r, LEAN] != 0.0:
            limit += 2.0 * (doubt[0] * abs(check[r, 0]) + doubt[1] * abs(check[r, SLOPE]))
        trust = (1.0 + (off / limit) ** 2) ** -2
        for i in range(4):
            for m in range(STATE):
                right[i * STATE + m] += trust * weights[i] * vector[r, m]
            for j in range(4):
                both = trust * weights[i] * weights[j]
                for m in range(STATE):
                    for n in range(STATE):
                        information[i * STATE + m, j * STATE + n] += both * normal[r, m, n]


class AttitudeSmoother:
    """Fixed-lag smoother: intervals in, final knots out."""

    def __init__(self, start_ns: int) -> None:
        """Begin at a time; the first interval to add starts there."""
        self.start_ns = start_ns
        self.intervals = 0
        self._forgotten = 0                      # fixed knots that are not kept any more
        self._fixed: list[Array] = []
        self._sigma: list[Array] = []
        self._doubt = SIGMA[[CROSSFALL, SLOPE]]     # deviations of the newest knot's
        self._knots = Knots(SIGMA, TIME, 1e-9 * KNOT_NS)
        for _ in range(3):
            self._knots.append()

    @property
    def final_ns(self) -> int:
        """Time before which the spline will not change any more."""
        return self.start_ns + max(self._forgotten + len(self._fixed) - 3, 0) * KNOT_NS

    def forget(self, before_ns: int) -> None:
        """Drop the final part before a time that nobody will ask for."""
        old = (before_ns - self.start_ns) // KNOT_NS - self._forgotten
        old = max(min(old, len(self._fixed) - 4), 0)
        del self._fixed[:old], self._sigma[:old]
        self._forgotten += old

    def finished(self, since_ns: int | None = None) -> Attitude:
        """Return the final part that is kept, from the interval of a time on."""
        skip = 0 if since_ns is None else max(
            (since_ns - self.start_ns) // KNOT_NS - self._forgotten, 0)
        knots = np.array(self._fixed[skip:]).reshape(-1, STATE)[:, :3]
        start_ns = self.start_ns + (self._forgotten + skip) * KNOT_NS
        return Attitude(start_ns, knots, np.array(self._sigma[skip:]).reshape(-1, STATE)[:, :2])

    def add_interval(self, evidence: Evidence, rows: NDArray[np.intp]) -> None:
        """Take some rows of statements, those in the next interval; fix the knot old enough."""
        self._knots.append()
        newest = slice(-4 * STATE, None)
        _accumulate(evidence.stamps_ns - self.start_ns, evidence.normal, evidence.vector,
                    evidence.check, evidence.value, evidence.scale, rows,
                    self._knots.solution[-4:], self._doubt,
                    self._knots.information[newest, newest], self._knots.vector[newest])
        self.intervals += 1
        self._knots.solve()
        self._doubt = self._knots.deviation(-1)[[CROSSFALL, SLOPE]]
        if self.intervals - self._forgotten - len(self._fixed) > LAG:
            self._fix_oldest()

    def finish(self) -> None:
        """Fix all knots: nothing more will be told."""
        self._knots.solve()
        while self._forgotten + len(self._fixed) < self.intervals + 3:
            self._fix_oldest()

    def _fix_oldest(self) -> None:
        value, sigma = self._knots.drop_oldest()
        self._fixed.append(value)
        self._sigma.append(sigma)
