# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A source of scans that needs nothing: a room with someone walking about in it."""

from __future__ import annotations

import math

import numpy as np

from stri_mapping.lms_emulator.turns import Array, Turn
from stri_mapping.scan import MIRROR_TURN

# Metres: the walls ahead, to the left and to the right; the person's radius and path.
AHEAD, LEFT, RIGHT = 6.0, 4.0, 3.0
RADIUS, PATH_RADIUS, PATH_CENTRE = 0.25, 1.2, 3.0
NOISE = 0.010
# Seconds for one round of the person.
ROUND = 6.0
WALL, PERSON = 60.0, 30.0       # per cent of white


class Room:
    """Three walls ahead, left and right, one column, and a person who walks in a circle."""

    def __init__(self, seed: int = 0) -> None:
        """Draw the noise from a seed: every turn has its own."""
        self._seed = seed

    def turn(self, number: int, bearings: Array) -> Turn:
        """Return what a turn measured; see `TurnSource`."""
        angle = np.deg2rad(bearings)
        ranges = walls(angle)
        walked = 2.0 * math.pi * number * MIRROR_TURN / ROUND
        person = _disc(angle, PATH_CENTRE + PATH_RADIUS * math.cos(walked),
                       PATH_RADIUS * math.sin(walked))
        rng = np.random.default_rng((self._seed, number))
        nearer = person < ranges
        noise = NOISE * rng.standard_normal(len(ranges))
        remission = np.where(nearer, PERSON, WALL) * (1.0 + 0.03 * rng.standard_normal(len(angle)))
        return Turn(np.where(nearer, person, ranges) + noise, remission)


def walls(angle: Array) -> Array:
    """Return the exact distance (n,) of the walls at bearings (n,) in radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    side = np.where(sin >= 0.0, LEFT, RIGHT)
    with np.errstate(divide='ignore'):
        return np.asarray(np.minimum(np.where(cos > 1e-9, AHEAD / cos, np.inf),
                                     np.where(np.abs(sin) > 1e-9, side / np.abs(sin), np.inf)))


def _disc(angle: Array, x: float, y: float) -> Array:
    """Return the distance (n,) of an upright cylinder; +inf beside it."""
    along = x * np.cos(angle) + y * np.sin(angle)
    half = RADIUS**2 - (x * x + y * y - along**2)
    with np.errstate(invalid='ignore'):
        return np.where((half >= 0.0) & (along > 0.0), along - np.sqrt(half), np.inf)
