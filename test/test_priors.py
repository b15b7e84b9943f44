# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The priors of the joint fit are the derivatives of what they say they are."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.typing import NDArray

from stri_mapping import geometry
from stri_mapping.stri.priors import add_slip
from stri_mapping.stri.spline import pose_at, velocity_at

Array = NDArray[np.float64]

H = 0.1


def slip_of(knots: Array, forward: Array, slip: Array, first: int = 0) -> tuple[Array, Array]:
    """Return information and slope that the prior adds to knots from the first on."""
    n = len(knots) - first
    information, slope = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    add_slip(knots, H, first, len(knots), 0, forward, slip, information, slope)
    return information, slope


def arc(mount: Array, speed: float, rate: float, sideways: float = 0.0) -> Array:
    """Return coefficients of the path of a scanner on a base_link with a constant twist."""
    times = H * np.arange(-20.0, 29.0)[:, None]
    base = geometry.exp(times * np.array([speed, sideways, rate]))
    samples = geometry.compose(base, mount)
    samples[:, 2] = base[:, 2] + mount[2]           # not wrapped
    # coefficients whose spline takes the samples at the knots; its loose ends are cut off
    n = len(samples)
    matrix = np.eye(n) * 4.0 / 6.0 + (np.eye(n, k=1) + np.eye(n, k=-1)) / 6.0
    return np.asarray(np.linalg.solve(matrix, samples))[20:-20]


mounts = st.builds(lambda x, y, yaw: np.array([x, y, yaw]), st.floats(-3.0, 3.0),
                   st.floats(-2.0, 2.0), st.floats(-np.pi, np.pi))


@settings(deadline=None, max_examples=50)
@given(mounts, st.floats(-15.0, 15.0), st.floats(-0.4, 0.4))
def test_a_base_that_rolls_is_left_alone_whatever_the_mount(
    mount: Array, speed: float, rate: float,
) -> None:
    """A scanner ahead of the axle goes sideways in a curve; base_link does not."""
    knots = arc(mount, speed, rate)
    forward = np.array([np.cos(mount[2]), -np.sin(mount[2])])
    information, slope = slip_of(knots, forward, np.array([mount[0], 1.0, 0.0]))
    # a cubic spline's slope at its knots is right to the fourth power of the angle between them
    sideways = (abs(speed) + np.hypot(*mount[:2]) * abs(rate)) * (rate * H) ** 2
    assert np.all(np.abs(slope) <= np.sqrt(np.diag(information)) * sideways + 1e-9)


@settings(deadline=None, max_examples=50)
@given(mounts, st.floats(-15.0, 15.0), st.floats(-0.4, 0.4), st.integers(0, 2 ** 31))
def test_slope_is_the_derivative_of_the_sideways_speed_squared(
    mount: Array, speed: float, rate: float, seed: int,
) -> None:
    """A step against the slope lessens the sideways speed that the spline itself has."""
    rng = np.random.default_rng(seed)
    knots = arc(mount, speed, rate, sideways=0.02)
    forward = np.array([np.cos(mount[2]), -np.sin(mount[2])])
    information, slope = slip_of(knots, forward, np.array([mount[0], 1.0, 0.0]))
    way = rng.standard_normal(knots.shape) * 1e-5
    change = 0.5 * (energy(knots + way, mount) - energy(knots - way, mount))
    # e is 0.02 m/s, far from the tail at twice 1 m/s: Cauchy takes 1e-4 of it
    scale = np.sqrt(way.ravel() @ information @ way.ravel()) * 0.02
    assert abs(change - slope @ way.ravel()) <= 0.01 * scale + 1e-9


def energy(knots: Array, mount: Array) -> float:
    """Return half the sum of squares of base_link's sideways speed at the knots, unit sigma."""
    total, count = 0.0, len(knots)
    knots = np.concatenate([knots, knots[-1:]])     # of no weight at the last knot
    pose, velocity = np.empty(3), np.empty(3)
    for k in range(1, count - 1):
        t = (k - 1) * H
        pose_at(knots, H, t, np.empty(4), pose)
        velocity_at(knots, H, t, velocity)
        yaw = pose[2] - mount[2]
        total += (-np.sin(yaw) * velocity[0] + np.cos(yaw) * velocity[1]
                  - mount[0] * velocity[2]) ** 2
    return 0.5 * total


def test_first_knots_stay_and_what_can_go_sideways_is_free() -> None:
    """Fixed knots take no share, the others what they have among all; infinity says nothing."""
    knots, forward = arc(np.zeros(3), 5.0, 0.1, 0.3), np.array([1.0, 0.0])
    slip = np.array([0.0, 0.1, 1.0])
    information, slope = slip_of(knots, forward, slip)
    later, pull = slip_of(knots, forward, slip, first=5)
    np.testing.assert_allclose(pull[3:], slope[18:])
    np.testing.assert_allclose(later[6:, 6:], information[21:, 21:])
    free, none = slip_of(knots, forward, np.array([0.0, np.inf, 1.0]))
    assert not free.any() and not none.any()
