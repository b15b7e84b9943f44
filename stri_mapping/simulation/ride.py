# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The body on its springs: roll, pitch and heave from road, braking and corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import bilinear, lfilter, lfilter_zi

from stri_mapping.simulation.motion import KNOT, Motion, Path

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ride:
    """
    Springs, dampers and road of an ordinary car or van.

    Attributes
    ----------
    frequency, damping
        Natural frequency of the body in Hz and damping ratio.
    dive, lean
        Pitch and roll per acceleration, rad per m/s^2.
    roughness
        Displacement density of the road at 0.1 cycles a metre, m^3 (ISO 8608: class A is
        around 16e-6, class B 64e-6).
    wheelbase, track
        Metres.
    buzz
        Standard deviation of the engine's shake in roll and pitch, radians, around 12 Hz.

    """

    frequency: float = 1.4
    damping: float = 0.3
    dive: float = np.deg2rad(0.25)
    lean: float = np.deg2rad(0.4)
    roughness: float = 24e-6
    wheelbase: float = 2.7
    track: float = 1.5
    buzz: float = np.deg2rad(0.01)


def drive(path: Path, distance: Array, rng: np.random.Generator, vibration: float = 1.0,
          ride: Ride = Ride()) -> Motion:
    """
    Return the motion of a vehicle along a path.

    base_link is on the ground under the middle of the rear axle, where a car at rest has no
    sideways speed; it rolls, pitches and heaves with the body.

    Parameters
    ----------
    path
        Where base_link goes.
    distance
        (n,) arc length on the path at the knots, metres.
    rng
        Draws the road.
    vibration
        Scale of roll, pitch and heave: 1 as the ride has them, 0 none.
    ride
        Springs and road.

    Returns
    -------
    Motion
        Through n knots.

    """
    planar = path.at(distance)
    poses = np.zeros((len(distance), 6))
    poses[:, [0, 1, 5]] = planar
    if vibration > 0.0:
        poses[:, 2:5] = vibration * _body(distance, planar, rng, ride)
    return Motion(poses)


def _body(distance: Array, planar: Array, rng: np.random.Generator, ride: Ride) -> Array:
    """Return heave, roll and pitch (n, 3) of the sprung body."""
    speed = np.gradient(distance, KNOT)
    braking = -np.gradient(speed, KNOT)
    sideways = speed * np.gradient(planar[:, 2], KNOT)
    middle = _road(ride, rng)
    cross = _road(ride, rng)
    front, rear = middle.height(distance + ride.wheelbase), middle.height(distance)
    # the two wheel tracks differ the more the shorter the wave
    tilt = (cross.height(distance) - cross.height(distance - ride.track)) / ride.track
    heave = _sprung(0.5 * (front + rear), ride)
    roll = _sprung(0.5 * tilt + ride.lean * sideways, ride)
    pitch = _sprung((rear - front) / ride.wheelbase + ride.dive * braking, ride)
    buzz = ride.buzz * np.sqrt(2.0)
    phase = 2.0 * np.pi * 12.0 * KNOT * np.arange(len(distance))
    roll = roll + buzz * np.sin(phase + rng.uniform(0.0, 6.28))
    pitch = pitch + buzz * np.sin(1.13 * phase + rng.uniform(0.0, 6.28))
    return np.column_stack([heave, roll, pitch])


@dataclass(frozen=True)
class _Waves:
    """A road profile: waves along the distance."""

    wavenumber: Array
    amplitude: Array
    phase: Array

    def height(self, distance: Array) -> Array:
        """Return the profile's height (n,) in metres at distances (n,)."""
        total = np.zeros(len(distance))
        for k, a, p in zip(self.wavenumber, self.amplitude, self.phase):
            total += a * np.sin(k * distance + p)
        return total


def _road(ride: Ride, rng: np.random.Generator) -> _Waves:
    """Return a profile of density ``roughness (n / 0.1)^-2``, waves of 0.5 to 50 m (ISO 8608)."""
    edges = np.geomspace(0.02, 2.0, 49)
    n, width = np.sqrt(edges[1:] * edges[:-1]), np.diff(edges)
    amplitude = np.sqrt(2.0 * ride.roughness * (n / 0.1) ** -2 * width)
    jitter = rng.uniform(0.95, 1.05, len(n))
    return _Waves(2.0 * np.pi * n * jitter, amplitude, rng.uniform(0.0, 2.0 * np.pi, len(n)))


def _sprung(road: Array, ride: Ride) -> Array:
    """Return the answer of the sprung body to what its wheels do."""
    omega = 2.0 * np.pi * ride.frequency
    spring = 2.0 * ride.damping * omega
    b, a = bilinear([spring, omega**2], [1.0, spring, omega**2], fs=1.0 / KNOT)
    answer, _ = lfilter(b, a, road, zi=lfilter_zi(b, a) * road[0])
    return np.asarray(answer)
