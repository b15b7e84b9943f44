# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
What the newest scans alone tell of the motion, by the slope idea, beside that of the path.

Where the path may have lost the motion another one is proposed, if it is decisively better; where
scans are too rare for an extrapolated path to be a good start, a change of its twist.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.proposal import Profile, SlopeSearch

Array = NDArray[np.float64]

CHANGES = np.linspace(-1.5, 1.5, 13), np.deg2rad(np.linspace(-60.0, 60.0, 13))
TURNS = np.deg2rad(np.array([-4.0, 0.0, 4.0]))
ACCELERATIONS = (0.0, -2.5, 2.5)        # m/s^2
MANY = 20       # scans, fewer do not tell an acceleration, nor, a few of them, leaves from walls
FARTHEST = 12.0             # m/s from the path's speed to the farthest that is tried
DOUBTED, SLOWLY_DOUBTED = 9.0, 5.0      # m/s, the least reach when the path is doubted
FINEST, COARSEST = 15, 0.4  # candidates to either side at the least; m/s between them at the most
MARGIN = 0.004              # metres, the least by which a proposal must be better
DECISIVE = 0.7              # cost of a proposal over that of others, to be believed at once
BETTER, LOOKS = 0.92, 3     # to be believed when found by so many looks in a row
PATIENCE = 0.7              # seconds between them at the most
SAME, GAINED = 0.5, 4.0     # m/s, m/s^2 within which they have found the same
SEEN = 0.25                 # share of rays on what stands, below which no motion can be told
SEEN_WELL = 0.5             # below which it must be decisively better
TURNED_BACK = 1.0           # m/s one way, then the other: hardly within a moment
APART = 1.5                 # m/s to other speeds that must be clearly worse


class Recovery:
    """
    Looks for another motion while that of the path is in doubt.

    What one look finds decisively better is believed at once; what is merely better, or goes the
    other way, when several looks in a row, each with its own scans, have found the same.

    Parameters
    ----------
    mount
        (3,) planar pose of the scanner in base_link.

    Attributes
    ----------
    confirmed
        Whether the path's motion has not been in doubt since a look last found it where it is.
        Until then looks go on, as far around it as it was in doubt: surfaces that came into view
        with a wrong motion may agree with it.

    """

    def __init__(self, mount: Array) -> None:
        """Begin with nothing found."""
        self.confirmed = True
        self._mount = mount
        self._sigma = 0.0           # the largest, of the path's speed, since it was confirmed
        self._found: list[tuple[float, float]] = []     # seconds and speed, of looks in a row

    def another_motion(
        self, profiles: list[Profile], now: Array, gain: float, sigma: float, doubted: bool,
    ) -> tuple[Array, float] | None:
        """
        Look for a motion that tells scans better than that of the path.

        Parameters
        ----------
        profiles
            The newest scans, NaN on what is known to move.
        now
            (3,) twist of base_link as the path has it.
        gain
            Acceleration in m/s^2 by which it has come to its speed.
        sigma
            Standard deviation of its speed in m/s: speeds within six of the largest since the
            motion was confirmed are tried.
        doubted
            Whether known surfaces speak against it, whatever its deviation.

        Returns
        -------
        tuple or None
            Twist (3,) at the newest scan, and acceleration in m/s^2; None where there is none.

        """
        self._sigma = max(sigma, 0.0 if self.confirmed else self._sigma)
        self.confirmed = False
        seen = np.mean([np.isfinite(ranges).mean() for _, _, ranges in profiles])
        if seen < SEEN:
            return None
        many = len(profiles) >= MANY
        least_reach = (DOUBTED if many else SLOWLY_DOUBTED) * doubted
        reach = min(max(6.0 * self._sigma, least_reach), FARTHEST)
        rates = ACCELERATIONS if many else ACCELERATIONS[:1]
        searches = [_search_around(profiles, self._mount, now, reach, a) for a in rates]
        search = min(searches, key=SlopeSearch.coarse_cost)
        twist, cost = search.best()
        own = min(searches, key=lambda each: abs(each.acceleration - gain))
        apart = min(search.cost_of(twist + [d, 0.0, 0.0]) for d in (-APART, APART))
        least = min(own.cost_of(now), apart)
        self.confirmed = bool(abs(twist[0] - now[0]) < SAME and seen > SEEN_WELL
                              and cost < BETTER * apart)
        if abs(twist[0] - now[0]) > 0.9 * reach or cost > least - MARGIN:
            return None
        decisive = cost < DECISIVE * least
        better = decisive or (seen > SEEN_WELL and cost < BETTER * least)
        again = many and better and self._again(profiles[-1][0], twist[0])
        turned = twist[0] * now[0] < 0.0 and min(abs(twist[0]), abs(now[0])) > TURNED_BACK
        if not (again or (decisive and not (many and turned))):
            return None
        self._found = []
        return twist, search.acceleration

    def _again(self, time: float, speed: float) -> bool:
        """Tell whether the looks before have found the same, but for what a vehicle may gain."""
        if self._found and time - self._found[-1][0] > PATIENCE:
            self._found = []
        self._found = [(t, v) for t, v in self._found
                       if abs(v - speed) < SAME + GAINED * (time - t)] + [(time, speed)]
        return len(self._found) >= LOOKS


def _search_around(
    profiles: list[Profile], mount: Array, twist: Array, reach: float, acceleration: float,
) -> SlopeSearch:
    """Return the search of scans for speeds around that of a twist."""
    aside = max(FINEST, math.ceil(reach / COARSEST))
    search = SlopeSearch(
        mount, twist[0] + np.linspace(-reach, reach, 2 * aside + 1),
        twist[2] + (TURNS if acceleration == 0.0 else TURNS[1:2]),
        acceleration=acceleration, until=profiles[-1][0])
    for profile in profiles:
        search.add(profile)
    return search


def changed_twist(profiles: list[Profile], mount: Array, now: Array) -> Array | None:
    """
    Look how the twist has changed between the newest two of three scans.

    Parameters
    ----------
    profiles, mount, now
        As in `Recovery`.

    Returns
    -------
    Array or None
        Twist (3,) of base_link that tells them better, None where there is none.

    """
    lags = (0.5 * (profiles[-1][0] - profiles[-2][0]),)
    search = SlopeSearch(mount, now[0] + CHANGES[0], now[2] + CHANGES[1], 0.0, lags)
    for profile in profiles:
        search.add(profile)
    twist, cost = search.best()
    return twist if cost < search.cost_of(now) - MARGIN else None
