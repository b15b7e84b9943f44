# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What moves in a street: cars, buses and people, each a rigid body on its own way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from stri_mapping import geometry
from stri_mapping.simulation.furniture import shape
from stri_mapping.simulation.motion import Path
from stri_mapping.simulation.ray_cast import RayCaster

Array = NDArray[np.float64]

# Interval of the knots of a mover's way, seconds.
KNOT = 0.1
# How far from the vehicle a mover is still of interest, metres: a person 35 m away is thinner
# than the step between two rays.
NEAR, NEAR_PERSON = 60.0, 35.0


class Mover:
    """
    A rigid body that moves over the ground.

    Attributes
    ----------
    kind
        What it is.
    caster
        Its shape, in its own frame: x ahead, z up.
    begin, end
        Seconds between which it is there.

    """

    def __init__(self, kind: str, caster: RayCaster, times: Array, poses: Array) -> None:
        """Take planar poses (n, 3) at times (n,), x, y, yaw in odom."""
        self.kind, self.caster = kind, caster
        self.begin, self.end = float(times[0]), float(times[-1])
        self._way = CubicSpline(times, poses)

    def at(self, times: ArrayLike) -> Array:
        """Return planar poses (n, 3) in odom at times (n,) between `begin` and `end`."""
        return np.asarray(self._way(np.clip(times, self.begin, self.end)))


class Traffic:
    """Adds movers along a vehicle's drive, as the street's other users."""

    def __init__(self, path: Path, distance: Array, times: Array,
                 rng: np.random.Generator) -> None:
        """Take the vehicle's path and its arc length (n,) on it at times (n,) in seconds."""
        self._path, self.rng = path, rng
        step = max(1, round(KNOT / float(times[1] - times[0])))
        self._times, self._distance = times[::step], distance[::step]
        self._shapes: dict[tuple[str, int], RayCaster] = {}
        self.movers: list[Mover] = []

    @property
    def duration(self) -> float:
        """Seconds of the drive."""
        return float(self._times[-1])

    def distance_at(self, time: float) -> float:
        """Return the vehicle's arc length at a time."""
        return float(np.interp(time, self._times, self._distance))

    def add(self, kind: str, along: Callable[[Array], Array], offset: Callable[[Array], Array],
            turned: float = 0.0) -> None:
        """
        Add a mover that goes along the vehicle's path.

        Parameters
        ----------
        kind
            'pedestrian' or a road vehicle.
        along, offset
            Arc length on the path and metres to its left, as functions of times (n,).
        turned
            Heading against the path's, radians.

        """
        t = self._times
        s = along(t)
        reach = NEAR_PERSON if kind == 'pedestrian' else NEAR
        near = np.flatnonzero(np.abs(s - self._distance) < reach)
        if len(near) < 4:
            return
        span = slice(int(near[0]), int(near[-1]) + 1)
        side = np.zeros((len(t[span]), 3))
        side[:, 1], side[:, 2] = offset(t[span]), turned
        # a model of each kind is drawn four times, then used again
        model = (kind, int(self.rng.integers(4)))
        if model not in self._shapes:
            self._shapes[model] = RayCaster(shape(self.rng, kind))
        self.movers.append(Mover(kind, self._shapes[model], t[span],
                                 geometry.compose(self._path.at(s[span]), side)))

    def oncoming(self, kind: str, meeting: float, speed: float, offset: float) -> None:
        """Add a vehicle that comes towards ours and meets it at a time."""
        s0 = self.distance_at(meeting)
        self.add(kind, lambda t: s0 - speed * (t - meeting), lambda t: np.full(len(t), offset),
                 np.pi)

    def alongside(self, kind: str, meeting: float, relative: float, offset: float) -> None:
        """
        Add a vehicle that keeps our speed plus `relative` and is level with us at a time.

        Where we are slower than it would fall back, it stands rather than to drive backwards,
        and it sways in its lane as it goes, not as time goes.
        """
        sway = self.rng.uniform(0.0, 6.28)
        speed = np.maximum(np.gradient(self._distance, self._times) + relative, 0.0)
        way = cumulative_trapezoid(speed, self._times, initial=0.0)
        way += self.distance_at(meeting) - float(np.interp(meeting, self._times, way))

        def along(t: Array) -> Array:
            return np.asarray(np.interp(t, self._times, way))

        self.add(kind, along, lambda t: offset + 0.15 * np.sin(0.06 * along(t) + sway))

    def walking(self, start: float, speed: float, offset: float) -> None:
        """Add a person on the pavement, at arc length `start` when the drive begins."""
        sway = self.rng.uniform(0.0, 6.28)
        self.add('pedestrian', lambda t: start + speed * t,
                 lambda t: offset + 0.04 * np.sin(6.0 * t + sway), 0.0 if speed > 0.0 else np.pi)

    def crossing(self, at: float, begin: float, speed: float, first: float) -> None:
        """Add a person who crosses 13 m of street at arc length `at`, from offset `first` on."""
        self.add('pedestrian', lambda t: np.full(len(t), at),
                 lambda t: first - np.clip(speed * (t - begin), 0.0, 13.0), -0.5 * np.pi)

    def facts(self) -> list[dict[str, Any]]:
        """Return what moves, and when it is near, as plain JSON values."""
        return [{'kind': m.kind, 'begin_s': round(m.begin, 1), 'end_s': round(m.end, 1)}
                for m in self.movers]


def ordinary(traffic: Traffic, amount: float, lane: float = 3.3,
             pavement: tuple[float, float] = (7.2, 9.0)) -> None:
    """
    Add what a street has at any time: oncoming and passing vehicles, people on the pavement.

    Parameters
    ----------
    traffic
        Takes the movers.
    amount
        1 for an ordinary street, 0 for an empty one.
    lane
        Offset of the lane to our left, where they come towards us and pass, metres.
    pavement
        Offsets between which people walk, metres.

    """
    if amount <= 0.0:
        return
    rng = traffic.rng
    time = rng.uniform(2.0, 8.0)
    while time < traffic.duration:
        if rng.random() < 0.75:
            kind = str(rng.choice(['car', 'car', 'estate', 'van', 'truck', 'bus']))
            traffic.oncoming(kind, time, rng.uniform(5.0, 12.0), lane + rng.uniform(-0.2, 0.3))
            time += 3.0
        else:
            kind = str(rng.choice(['car', 'car', 'van', 'bus']))
            relative = float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 5.0))
            time += 10.0 / abs(relative)
            traffic.alongside(kind, time, relative, lane + rng.uniform(-0.1, 0.3))
            time += 10.0 / abs(relative)
        time += rng.exponential(6.0 / amount)
    first, last = traffic.distance_at(0.0), traffic.distance_at(traffic.duration)
    low, high = min(first, last) - 60.0, max(first, last) + 60.0
    for _ in range(round(amount * (high - low) / 14.0)):
        speed = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.7))
        # people are spread over where we meet them, not over where they set out
        meeting = rng.uniform(0.0, traffic.duration)
        place = traffic.distance_at(meeting) + rng.uniform(-20.0, 20.0)
        traffic.walking(place - speed * meeting, speed, rng.uniform(*pavement))
