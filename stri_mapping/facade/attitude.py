# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Roll, pitch and heave of the vehicle over time, from what its vertical scans tell.

The state x(t) = (roll, pitch, heave, crossfall, lean) is a uniform cubic B-spline.  Its knots
follow first-order Gauss-Markov processes about zero: the body on its springs, the road's slope
across it, and how far the walls of the moment are from upright.  Road and walls are statements
linear in the state (`survey`), so that the most likely spline is one linear solve; old knots are
marginalised, never held.  Where nothing is told, all returns to zero: the planar path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.survey import Evidence, STATE
from stri_mapping.stri.spline import basis

Array = NDArray[np.float64]

# Knot interval, nanoseconds: a tenth of a second bends less than 2 % at the springs' 1.4 Hz.
KNOT_NS = 100_000_000
# Intervals heard after a knot before it is final.
LAG = 3
# Standard deviation and correlation time (s) of each part of the state, radians and metres.
SIGMA = np.array([np.deg2rad(1.0), np.deg2rad(1.0), 0.03, np.deg2rad(0.4), np.deg2rad(0.1)])
TIME = np.array([0.3, 0.3, 0.3, 60.0, 0.5])
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
    weights = np.empty(4)
    for i in range(len(stamps)):
        since = stamps[i] - start
        k = min(since // KNOT_NS, len(knots) - 4)
        u = (since - k * KNOT_NS) / KNOT_NS
        if since < 0 or u > 1.0:
            continue
        basis(u, weights)
        for m in range(3):
            attitude[i, m] = 0.0
            for j in range(4):
                attitude[i, m] += weights[j] * knots[k + j, m]
        for m in range(2):
            told[i, m] = max(sigma[k + 1, m], sigma[k + 2, m]) < OBSERVED


@numba.njit(cache=True)
def _accumulate(  # type: ignore[no-untyped-def]
    since, normal, vector, check, value, scale, rows, knots, information, right,
):
    """
    Add statements to the normal equations of the four knots (4, 5) of their interval.

    Those far off what the knots predict hardly count (Geman-McClure).
    """
    weights = np.empty(4)
    for r in rows:
        basis((since[r] % KNOT_NS) / KNOT_NS, weights)
        off = -value[r]
        for i in range(4):
            for m in range(STATE):
                off += weights[i] * knots[i, m] * check[r, m]
        trust = (1.0 + (off / scale[r]) ** 2) ** -2
        for i in range(4):
            for m in range(STATE):
                right[i * STATE + m] += trust * weights[i] * vector[r, m]
            for j in range(4):
                both = trust * weights[i] * weights[j]
                for m in range(STATE):
                    for n in range(STATE):
                        information[i * STATE + m, j * STATE + n] += both * normal[r, m, n]


class AttitudeSmoother:
    """
    Fixed-lag smoother: intervals in, final knots out.

    The normal equations of the knots that are not final yet are kept; each interval adds one
    knot and its statements, and the oldest knot leaves by a Schur complement.
    """

    def __init__(self, start_ns: int) -> None:
        """Begin at a time; the first interval to add starts there."""
        self.start_ns = start_ns
        self.intervals = 0
        self._fixed: list[Array] = []
        self._sigma: list[Array] = []
        self._information: Array = np.zeros((0, 0))
        self._vector: Array = np.zeros(0)
        self._solution: Array = np.zeros((0, STATE))
        self._covariance: Array = np.zeros((0, 0))
        for _ in range(3):
            self._append_knot()

    @property
    def final_ns(self) -> int:
        """Time before which the spline will not change any more."""
        return self.start_ns + max(len(self._fixed) - 3, 0) * KNOT_NS

    def finished(self, since_ns: int | None = None) -> Attitude:
        """Return the final part, from the interval of a time on."""
        skip = 0 if since_ns is None else max((since_ns - self.start_ns) // KNOT_NS, 0)
        knots = np.array(self._fixed[skip:]).reshape(-1, STATE)[:, :3]
        return Attitude(self.start_ns + skip * KNOT_NS, knots,
                        np.array(self._sigma[skip:]).reshape(-1, 2))

    def add_interval(self, evidence: Evidence, rows: NDArray[np.intp]) -> None:
        """Take some rows of statements, those in the next interval; fix the knot old enough."""
        self._append_knot()
        newest = slice(-4 * STATE, None)
        _accumulate(evidence.stamps_ns - self.start_ns, evidence.normal, evidence.vector,
                    evidence.check, evidence.value, evidence.scale, rows, self._solution[-4:],
                    self._information[newest, newest], self._vector[newest])
        self.intervals += 1
        self._solve()
        if self.intervals - len(self._fixed) > LAG:
            self._fix_oldest()

    def finish(self) -> None:
        """Fix all knots: nothing more will be told."""
        self._solve()
        while len(self._fixed) < self.intervals + 3:
            self._fix_oldest()

    def _append_knot(self) -> None:
        """Add a knot that follows from the one before it by its Gauss-Markov process."""
        n = len(self._vector)
        information, vector = np.zeros((n + STATE, n + STATE)), np.zeros(n + STATE)
        information[:n, :n], vector[:n] = self._information, self._vector
        self._information, self._vector = information, vector
        new = np.arange(n, n + STATE)
        if n == 0:
            information[new, new] += SIGMA**-2
            self._solution = np.zeros((1, STATE))
            return
        rho = np.exp(-1e-9 * KNOT_NS / TIME)
        weight = 1.0 / (SIGMA**2 * (1.0 - rho**2))
        old = new - STATE
        information[new, new] += weight
        information[old, old] += rho**2 * weight
        information[old, new] -= rho * weight
        information[new, old] -= rho * weight
        self._solution = np.concatenate([self._solution, rho * self._solution[-1:]])

    def _solve(self) -> None:
        self._covariance = np.asarray(np.linalg.inv(self._information), dtype=np.float64)
        self._solution = (self._covariance @ self._vector).reshape(-1, STATE)

    def _fix_oldest(self) -> None:
        """Take the oldest knot's value as final and pass on what it says of its neighbours."""
        self._fixed.append(self._solution[0])
        self._sigma.append(np.sqrt(np.diag(self._covariance)[:2]))
        gain = np.linalg.solve(self._information[:STATE, :STATE],
                               self._information[:STATE, STATE:])
        self._vector = self._vector[STATE:] - gain.T @ self._vector[:STATE]
        self._information = self._information[STATE:, STATE:] - gain.T @ (
            self._information[:STATE, STATE:])
        self._covariance = self._covariance[STATE:, STATE:]
        self._solution = self._solution[1:]
