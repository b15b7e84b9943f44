# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A way through town: straight streets that meet at corners, and the drive along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from stri_mapping import geometry
from stri_mapping.simulation.motion import KNOT, Path, random_speed
from stri_mapping.simulation.site import Site
from stri_mapping.simulation.street import Profile, street

Array = NDArray[np.float64]

# Metres of path that a corner takes, and of street beyond the ends of a way.
CORNER, BEYOND = 17.0, 45.0


@dataclass(frozen=True)
class Leg:
    """
    One straight street of a way.

    Attributes
    ----------
    length
        Metres from corner to corner.
    turn
        Radians at its end, positive to the left; 0 where the way ends.

    """

    length: float
    turn: float = 0.0


def path_along(legs: Sequence[Leg]) -> tuple[Path, Array]:
    """
    Return the path along legs from the origin, heading along x, and where its corners are.

    Returns
    -------
    path : Path
        Straight along the legs, its corners rounded.
    corners : Array
        (k,) arc length at the middle of each corner.

    """
    pieces: list[tuple[float, float]] = []
    corners, done, cut = [], 0.0, 0.0
    for leg in legs:
        ahead = _tangent(leg.turn) if leg.turn else 0.0
        straight = leg.length - cut - ahead
        pieces.append((straight, 0.0))
        done += straight
        if leg.turn:
            pieces.append((CORNER, leg.turn))
            corners.append(done + 0.5 * CORNER)
            done += CORNER
        cut = ahead
    return Path(pieces), np.array(corners)


def _tangent(turn: float) -> float:
    """Return how far before the corner point the path has to begin its turn, metres."""
    x, y, _ = Path([(CORNER, turn)]).at(np.array([CORNER]))[0]
    return float(x - y / np.tan(turn))


def build_streets(site: Site, legs: Sequence[Leg], profile: Profile = Profile(),
                  before: float | None = None) -> None:
    """
    Add the streets along legs from the site's origin, heading along its x axis.

    Parameters
    ----------
    site
        Takes them.
    legs
        The streets.
    profile
        Cross-section of all of them.
    before
        The turn into the first leg where the way is closed; None where it is open, and then the
        first and the last street go on for `BEYOND` metres.

    """
    half = np.tan(0.5 * (before or 0.0))
    pose = np.zeros(3)
    for i, leg in enumerate(legs):
        begin = BEYOND if before is None and i == 0 else 0.0
        end = BEYOND if before is None and i == len(legs) - 1 else 0.0
        corner = np.tan(0.5 * leg.turn)
        street(site.at(*pose.tolist()), leg.length, profile,
               profile.left * half - begin, -profile.left * corner + end,
               -profile.right * half - begin, profile.right * corner + end)
        pose = geometry.compose(pose, [leg.length, 0.0, leg.turn])
        half = corner


def staircase(rng: np.random.Generator, length: float) -> list[Leg]:
    """Return legs of at least `length` metres that turn left and right in turn: no two cross."""
    legs: list[Leg] = []
    side = float(rng.choice([-1.0, 1.0]))
    while sum(leg.length for leg in legs) < length:
        legs.append(Leg(rng.uniform(90.0, 190.0), side * np.deg2rad(rng.uniform(75.0, 100.0))))
        side = -side
    return [*legs, Leg(100.0)]


def distance_on(path: Path, corners: Array, rng: np.random.Generator, low: float,
                high: float, slow: float = 3.3) -> Array:
    """
    Return the arc length at the knots of a drive to the path's end, slow round its corners.

    Parameters
    ----------
    path, corners
        As `path_along` gives them.
    rng
        Draws the speed.
    low, high
        Limits of the speed between corners, m/s.
    slow
        Speed in the middle of a corner, m/s.

    Returns
    -------
    Array
        (n,) metres, from 0.

    """
    s = np.linspace(0.0, path.length, round(path.length / 0.1) + 1)
    speed = random_speed(s, rng, low, high, period=35.0)
    for corner in corners:
        near = np.clip(1.0 - np.abs(s - corner) / 32.0, 0.0, 1.0)
        weight = 0.5 - 0.5 * np.cos(np.pi * np.clip(1.6 * near, 0.0, 1.0))
        speed = speed + weight * (np.minimum(slow, speed) - speed)
    arrival = CubicSpline(s, 1.0 / speed).antiderivative()(s)
    t = np.arange(int(arrival[-1] / KNOT) + 1) * KNOT
    return np.asarray(CubicSpline(arrival, s)(t))
