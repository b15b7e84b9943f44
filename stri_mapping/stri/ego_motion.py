# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Step 4 of the paper: the slopes of all curves combined to one twist of the vehicle.

Every curve that stands still obeys p' = -v - w x p.  Curves of moving objects do not, and lose
their weight.  The twist before and a vehicle's limits of acceleration act as one more
observation, so that the estimate coasts where the curves say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIDE_SLIP = 0.05                              # m/s at base_link, between the rear wheels
ACCELERATION = np.array([2.5, 0.5, 1.5])      # m/s^2, m/s^2, rad/s^2: how a twist may change
SCALE = 0.15                                  # m/s of disagreement that halves a curve's say


@dataclass(frozen=True, eq=False)
class Twist:
    """
    A twist of base_link at a moment.

    Attributes
    ----------
    value
        (3,) vx, vy, wz in m/s, m/s, rad/s.
    covariance
        (3, 3) of `value`.
    observed
        0 to 1: the share of the forward speed's information that came from the curves.
    agreeing
        Number of curves that agree with the twist.

    """

    value: Array
    covariance: Array
    observed: float
    agreeing: int


def combine(states: Array, sigmas: Array, before: Twist | None, dt: float) -> Twist:
    """
    Return the twist that the curves' slopes agree on.

    Parameters
    ----------
    states
        (m, 4) x, y, x', y' of the curves in base_link.
    sigmas
        (m, 2) standard deviations of x' and y'.
    before
        The twist `dt` seconds earlier, None where nothing is known.
    dt
        Seconds between the two twists, either sign.

    Returns
    -------
    Twist
        By iteratively reweighted least squares (Geman-McClure), started from `before`.

    """
    prior = np.diag([0.0, SIDE_SLIP ** -2, 0.0]) + 1e-9 * np.eye(3)
    target = np.zeros(3)
    if before is not None:
        spread = before.covariance + np.diag((ACCELERATION * max(abs(dt), 1e-3)) ** 2)
        information = np.linalg.inv(spread)
        target = information @ before.value
        prior = prior + information
    value = np.linalg.solve(prior, target)
    jacobian, slopes, weights = _rows(states, sigmas)
    robust = np.ones(len(slopes))
    for _ in range(12):
        if before is not None or _ > 0:
            residual = (slopes - jacobian @ value).reshape(-1, 2)
            robust = np.repeat((1.0 + (residual ** 2).sum(1) / SCALE ** 2) ** -2.0, 2)
        weighted = jacobian.T * (weights * robust)
        information = weighted @ jacobian
        step = np.linalg.solve(information + prior, weighted @ slopes + target)
        converged = np.abs(step - value).max() < 1e-5
        value = step
        if converged:
            break
    covariance = np.linalg.inv(information + prior)
    observed = float(information[0, 0] / (information[0, 0] + prior[0, 0]))
    return Twist(value, covariance, observed, int((robust[::2] > 0.25).sum()))


def _rows(states: Array, sigmas: Array) -> tuple[Array, Array, Array]:
    """Return Jacobian (2m, 3), slopes (2m,) and weights (2m,) of the curves' equations."""
    m = len(states)
    jacobian = np.zeros((2 * m, 3))
    jacobian[0::2, 0] = jacobian[1::2, 1] = -1.0
    jacobian[0::2, 2], jacobian[1::2, 2] = states[:, 1], -states[:, 0]
    return jacobian, states[:, 2:].ravel(), sigmas.ravel() ** -2.0
