# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The most likely course of a few quantities in time, from statements linear in them."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]


class Knots:
    """
    Knots of a state that follows Gauss-Markov processes of first order about zero.

    The normal equations of the knots that are not final yet are kept.  The oldest knot leaves by
    a Schur complement: it is marginalised, never held.

    Parameters
    ----------
    sigma, time
        (s,) standard deviation and correlation time in seconds of each part of the state.
    spacing
        Seconds from knot to knot.

    Attributes
    ----------
    information, vector
        (k s, k s) and (k s,) normal equations of the k knots; statements are added to them.
    solution
        (k, s) the most likely values as of the last `solve`; new knots follow from the one before.

    """

    def __init__(self, sigma: Array, time: Array, spacing: float) -> None:
        """Begin without knots."""
        self._size = len(sigma)
        self._rho = np.exp(-spacing / time)
        self._prior = np.diag(sigma**-2)
        # what a knot and the one after it have to do with each other
        weight = 1.0 / (sigma**2 * (1.0 - self._rho**2))
        self._link = np.block([[np.diag(self._rho**2 * weight), np.diag(-self._rho * weight)],
                               [np.diag(-self._rho * weight), np.diag(weight)]])
        self.information: Array = np.zeros((0, 0))
        self.vector: Array = np.zeros(0)
        self.solution: Array = np.zeros((0, self._size))
        self._factor: Array = np.zeros((0, 0))     # of the last `solve`, by Cholesky

    def append(self) -> None:
        """Add a knot that follows from the one before it."""
        n, size = len(self.vector), self._size
        information, vector = np.zeros((n + size, n + size)), np.zeros(n + size)
        information[:n, :n], vector[:n] = self.information, self.vector
        self.information, self.vector = information, vector
        if n == 0:
            information += self._prior
            self.solution = np.zeros((1, size))
            return
        information[n - size:, n - size:] += self._link
        self.solution = np.concatenate([self.solution, self._rho * self.solution[-1:]])

    def solve(self) -> None:
        """
        Find the most likely values.

        Raises
        ------
        np.linalg.LinAlgError
            If what was told is not finite.

        """
        self._factor, failed = lapack.dpotrf(self.information, lower=1)
        if failed:
            raise np.linalg.LinAlgError('information about the knots is not positive definite')
        solution, _ = lapack.dpotrs(self._factor, self.vector, lower=1)
        self.solution = solution.reshape(-1, self._size)

    def deviation(self, knot: int) -> Array:
        """Return the deviations (s,) of a knot as of the last `solve`; -1 is the newest."""
        count, size = len(self._factor), self._size
        # knots that have been dropped since then are still in the factor
        begin = count - (-knot if knot < 0 else len(self.solution) - knot) * size
        return _deviation(self._factor, begin, size)  # type: ignore[no-any-return]

    def drop_oldest(self) -> tuple[Array, Array]:
        """Return the oldest knot (s,) and its deviations (s,), and pass on what it tells."""
        size = self._size
        value, sigma = self.solution[0], self.deviation(0)
        across = self.information[:size, size:]
        _, gain, _ = lapack.dposv(self.information[:size, :size], across)
        self.vector = self.vector[size:] - gain.T @ self.vector[:size]
        self.information = self.information[size:, size:] - gain.T @ across
        self.solution = self.solution[1:]
        return value, sigma


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _deviation(factor: Array, begin: int, size: int) -> Array:
    """
    Return the deviations (size,) of rows from begin on, where L L' is the information.

    (L L')^-1 has the diagonal of Y' Y with L Y = the unit columns of those rows, and Y is zero
    above them.  So few rows are quicker done here than handed to LAPACK, and threads of its
    would take turns with the live graph's.
    """
    n = len(factor) - begin
    y = np.zeros((size, n))
    deviation = np.empty(size)
    for c in range(size):
        y[c, c] = 1.0
        total = 0.0
        for j in range(c, n):
            value = y[c, j] / factor[begin + j, begin + j]
            total += value * value
            for i in range(j + 1, n):
                y[c, i] -= value * factor[begin + i, begin + j]
        deviation[c] = np.sqrt(total)
    return deviation
