# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A drive that begins and ends at rest: what a scene's time is at any real time."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stri_mapping.simulation.motion import Motion

Array = NDArray[np.float64]

# A comfortable acceleration in m/s^2, and the least time for speeding up or slowing down, seconds.
ACCELERATION, SHORTEST = 2.5, 2.0


@dataclass(frozen=True)
class Timeline:
    """
    Scene time as a smooth function of real time.

    The scene stands still at `first` until `begin`, runs ever faster for `rise` seconds, then as
    fast as real time, ever slower for the last `fall` seconds, and stands still at `last`.  All
    that happens in it, the vehicle's motion and that of others, is slowed down alike, and pose
    and rays go by the same function, so that the truth is exact at all times.

    Attributes
    ----------
    first, last
        Seconds of the scene.
    rise, fall
        Real seconds; half as many of the scene pass in them.
    begin
        Real seconds; infinity for a vehicle that waits.

    """

    first: float
    last: float
    rise: float
    fall: float
    begin: float = math.inf

    @property
    def end(self) -> float:
        """When the vehicle stands still again, real seconds."""
        return self.begin + self.last - self.first + 0.5 * (self.rise + self.fall)

    def scene(self, times: ArrayLike) -> Array:
        """Return the scene's times (n,) at real times (n,), seconds."""
        t = np.asarray(times, dtype=float)
        if math.isinf(self.begin):
            return np.full(t.shape, self.first)
        since, until = t - self.begin, self.end - t
        rising = self.first + _covered(since, self.rise)
        falling = self.last - _covered(until, self.fall)
        return np.where(since < self.rise, rising, falling)

    def rate(self, times: ArrayLike) -> Array:
        """Return how fast the scene runs (n,) at real times (n,): 0 to 1."""
        t = np.asarray(times, dtype=float)
        if math.isinf(self.begin):
            return np.zeros(t.shape)
        return np.minimum(_pace((t - self.begin) / self.rise), _pace((self.end - t) / self.fall))


def make_timeline(motion: Motion, first: float, last: float) -> Timeline:
    """Return the timeline of a drive that speeds up and slows down as a car does."""
    speeds = np.abs(motion.twist([first, last])[:, 0])
    longest = max(last - first, 1e-3)
    rise, fall = (min(max(SHORTEST, 1.5 * v / ACCELERATION), longest) for v in speeds.tolist())
    return Timeline(first, last, rise, fall)


def _pace(x: Array) -> Array:
    """Return the smooth step from 0 to 1, whose steepest slope is 1.5."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))


def _covered(t: Array, ramp: float) -> Array:
    """Return the integral of `_pace` over the time t since its start, seconds."""
    x = np.clip(t / ramp, 0.0, 1.0)
    return np.asarray(ramp * x**3 * (1.0 - 0.5 * x) + np.maximum(t - ramp, 0.0))
