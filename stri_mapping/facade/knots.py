# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The most likely course of a few quantities in time, from statements linear in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    covariance
        (k s, k s) as of the last `solve`.

    """

    def __init__(self, sigma: Array, time: Array, spacing: float) -> None:
        """Begin without knots."""
        self._sigma, self._rho = sigma, np.exp(-spacing / time)
        self._size = len(sigma)
        self.information: Array = np.zeros((0, 0))
        self.vector: Array = np.zeros(0)
        self.solution: Array = np.zeros((0, self._size))
        self.covariance: Array = np.zeros((0, 0))

    def append(self) -> None:
        """Add a knot that follows from the one before it."""
        n, size = len(self.vector), self._size
        information, vector = np.zeros((n + size, n + size)), np.zeros(n + size)
        information[:n, :n], vector[:n] = self.information, self.vector
        self.information, self.vector = information, vector
        new = np.arange(n, n + size)
        if n == 0:
            information[new, new] += self._sigma**-2
            self.solution = np.zeros((1, size))
            return
        weight = 1.0 / (self._sigma**2 * (1.0 - self._rho**2))
        old = new - size
        information[new, new] += weight
        information[old, old] += self._rho**2 * weight
        information[old, new] -= self._rho * weight
        information[new, old] -= self._rho * weight
        self.solution = np.concatenate([self.solution, self._rho * self.solution[-1:]])

    def solve(self) -> None:
        """Find the most likely values, and how sure they are."""
        self.covariance = np.asarray(np.linalg.inv(self.information), dtype=np.float64)
        self.solution = (self.covariance @ self.vector).reshape(-1, self._size)

    def drop_oldest(self) -> tuple[Array, Array]:
        """Return the oldest knot (s,) and its deviations (s,), and pass on what it tells."""
        size = self._size
        value, sigma = self.solution[0], np.sqrt(np.diag(self.covariance)[:size])
        gain = np.linalg.solve(self.information[:size, :size], self.information[:size, size:])
        self.vector = self.vector[size:] - gain.T @ self.vector[:size]
        self.information = self.information[size:, size:] - gain.T @ (
            self.information[:size, size:])
        self.covariance = self.covariance[size:, size:]
        self.solution = self.solution[1:]
        return value, sigma
