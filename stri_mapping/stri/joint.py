# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The path of the scanner over the sliding spatio-temporal buffer, estimated jointly.

Everything here is in the scanner's own plane: its pose over time is a spline (see `spline`),
scans are merged to keyframes (`keyframe`), keyframes are paired over time and distance
(`window`, `pairs`), and the newest knots are fitted to all of it (`smoother`).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
import mmap

import numpy as np
from numpy.typing import NDArray

from stri_mapping import geometry
from stri_mapping.stri.config import JointConfig
from stri_mapping.stri.estimate import of_base, speed_sigma
from stri_mapping.stri.keyframe import merge
from stri_mapping.stri.range_error import RangeError
from stri_mapping.stri.rays import LABEL, RAY
from stri_mapping.stri.slant import pieces
from stri_mapping.stri.smoother import solve
from stri_mapping.stri.spline import pose_at, velocity_at
from stri_mapping.stri.trust import LABELS, NEW, Trust
from stri_mapping.stri.uncertainty import Uncertainty
from stri_mapping.stri.window import Window

Array = NDArray[np.float64]


# Geman-McClure scales in metres, of a fit's iterations and of the first fit's.
SCALES = np.array([0.2, 0.1, 0.06, 0.04])
START_SCALES = np.array([0.25, 0.25, 0.12, 0.12, 0.06, 0.06, 0.04])
START_ITERATIONS = 14
PARTS = (0, 4, START_ITERATIONS)        # iterations that go with one scan, taking up a motion
SLOW = 0.11           # seconds between scans, beyond which surfaces can't be followed
CERTAIN = 0.25        # m/s, standard deviation of a speed that is known
CLEAR, AGREED = 0.23, 0.7     # m/s, share of votes: a speed that tells who is wrong; usually 0.19
# Residuals of one surface repeat the same error in every pair; this many count as one.
DILUTION, SLOW_DILUTION = 60.0, 20.0
# m/s^2, rad/s^2: robots turn on the spot, but do not jump
SLOW_ACCELERATION, SLOW_ANGULAR_ACCELERATION = 2.0, 2.0
# m/s, m/s and rad/s between two motions that are not the same.
PARTED = np.array([0.3, 0.3, 0.04])
FADING = 0.7          # of acceleration from knot to knot where the path is extrapolated
ROOM, RECENT = 32768, 1024      # knots until new room is made, and of those how many go along


class JointPath:
    """
    The scanner's path in its first frame.

    Parameters
    ----------
    spacing
        Knot spacing in seconds.
    angle_step
        Radians between rays of a scan.
    mount
        (3,) x, y, yaw of the scanner in base_link.
    config
        Settings.

    """

    def __init__(
        self, spacing: float, angle_step: float, mount: Array, config: JointConfig,
    ) -> None:
        """Start with no scan."""
        self.h = spacing
        self.config = config
        self.knots = _zeros(ROOM)
        self.step = 0             # steps done: the spline is valid before step * h
        self.first = 0            # first knot still active
        self.settled = 0          # first knot that is not final
        self.sigma = np.inf       # of the speed at the newest knot, m/s
        self.uncertainty = Uncertainty(spacing)
        self.error = RangeError(config.pull, config.pull_sigma, config.pulls)
        self.trust = Trust()
        self.window = Window(spacing, angle_step, config.lags, config.distances, config.active)
        self.slow = spacing > SLOW
        self._judges = config.judge_surfaces and not self.slow
        self._kept = config.active if self.slow else max(config.active, config.kept)
        self._start = 0           # knot at which the motion was taken up
        self._forward = np.array([np.cos(mount[2]), -np.sin(mount[2])])
        self._slip = np.array([mount[0], max(config.slip, 1e-3), config.slip_arm])
        self._scans: list[tuple[float, float, Array]] = []     # start, end, rays
        self._newest = np.empty((0, RAY))        # rays of the newest keyframe's own interval
        h, c = spacing, config
        self._jerk = np.array([c.jerk, c.jerk, c.angular_jerk]) ** -2.0 * h ** -6
        linear, angular = c.acceleration, c.angular_acceleration
        if self.slow:
            linear, angular = SLOW_ACCELERATION, SLOW_ANGULAR_ACCELERATION
        self._acceleration = np.array([linear, linear, angular]) ** -2.0 * h ** -4
        self._straight = np.array([0.0, 0.0, (c.turn * h) ** -2.0])

    def add(self, start: float, end: float, rays: Array) -> None:
        """Take the prepared rays of a scan that lasted from start to end."""
        self._scans.append((start, end, rays))

    def begin(self, twist: Array) -> None:
        """Make the first fit, from a constant twist (3,) of the scanner in its own frame."""
        self.step = self.config.start_steps
        last = self.step + 3
        self.knots[:last] = geometry.exp(np.arange(last)[:, None] * self.h * twist)
        times = [t for k in range(2, self.step + 1) if (t := self._keyframe(k)) < np.inf]
        self._fit(0, last, min(times, default=np.inf), START_SCALES, START_ITERATIONS)
        # the first pose is where odom begins: it is final with the first fit
        self.first = max(4, last + 1 - self.config.active)
        self.settled = 4

    def advance(self, twist: Array | None = None) -> None:
        """
        Extend the path by one knot interval, for which all scans must have been added.

        Parameters
        ----------
        twist
            (3,) of the scanner in its own frame to start the fit from; the last one if None.

        """
        self.step += 1
        last = self.step + 3
        if last + 4 > len(self.knots):
            recent = slice(max(last - RECENT, 0), last)
            knots = _zeros(last + ROOM)
            knots[recent] = self.knots[recent]
            self.knots = knots
        self.knots[last - 1] = 2.0 * self.knots[last - 2] - self.knots[last - 3]
        if twist is not None:
            self._lay(twist)
        self.first = max(self.first, last - self.config.active)
        self.settled = max(self.settled, last - self._kept)
        self.window.forget((self.first - 3) * self.h)
        newest = self._keyframe(self.step)
        self._fit(self.first, last, newest, SCALES, self.config.iterations)

    def _lay(self, twist: Array) -> None:
        """Lay the newest two knots so that the newest interval is left with a twist."""
        last = self.step + 3
        end = geometry.compose(self.pose((self.step - 1) * self.h), geometry.exp(twist * self.h))
        velocity = geometry.compose([0.0, 0.0, end[2]], twist) - [0.0, 0.0, end[2]]
        knots = self.knots
        knots[last - 1] = knots[last - 3] + 2.0 * self.h * velocity
        knots[last - 2] = 0.25 * (6.0 * end - knots[last - 3] - knots[last - 1])

    def restart(self, twist: Array, acceleration: Array) -> Iterator[bool]:
        """
        Take up the motion again after losing it, in parts that take no scan much time.

        The path is laid anew from where it had that motion; if it had it at no time that is not
        final, from there, with no tie to the motion before.  Then all that is not final is
        fitted to its scans, and to those just before.

        Parameters
        ----------
        twist, acceleration
            (3,) of the scanner in its own frame at the newest knot, and its change in a second.

        Yields
        ------
        bool
            True after each part.  All are to be done before the path is extended.

        """
        begin = self.settled - 1
        parting = self._parting(twist, acceleration)
        if parting is None:
            self._start = begin + 2
        origin = begin if parting is None else parting
        before = self.h * np.arange(origin - self.step, 3)[:, None]
        twists = twist + before * acceleration
        twists[twists[:, :2] @ twist[:2] < 0.0] = 0.0   # it stood, rather than went the other way
        way = self.h * (np.cumsum(twists, axis=0) - 0.5 * (twists[0] + twists))
        self.knots[origin + 1:self.step + 4] = geometry.compose(
            self.pose(origin * self.h), geometry.exp(way))
        self.trust.pardon()
        newest = self.window.rebuild(begin * self.h, self.knots)
        yield True
        yield from self._parts_of_fit(begin + 2, self.step + 3, newest, START_SCALES, PARTS)

    def _parting(self, twist: Array, acceleration: Array) -> int | None:
        """Return the newest step, not final, at which the path had the motion to be taken up."""
        for step in range(self.step - 3, self.settled - 1, -1):
            heading = self.pose(step * self.h)[2]
            own = geometry.compose([0.0, 0.0, -heading], self.velocity(step * self.h))
            own[2] += heading
            line = twist + (step - self.step) * self.h * acceleration
            if np.all(np.abs(own - line) < PARTED):
                return step
        return None

    @property
    def final_until(self) -> float:
        """Time before which the path will not change any more."""
        return (self.settled - 3) * self.h

    def pose(self, t: float) -> Array:
        """Return the pose (3,) at a time; just beyond the newest knot it is extrapolated."""
        pose = np.empty(3)
        pose_at(self.knots, self.h, t, np.empty(4), pose)
        return pose

    def velocity(self, t: float) -> Array:
        """Return the velocity (3,) at a time, in the frame of the first scan."""
        velocity = np.empty(3)
        velocity_at(self.knots, self.h, t, velocity)
        return velocity

    def moving(self, labels: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Tell which rays, by their surfaces (n,), are not to be believed: these may move."""
        if not self._judges:
            return np.zeros(len(labels), np.bool_)
        return (labels >= 0) & (self.trust.weight[labels % LABELS] < NEW)

    def _extrapolate(self) -> None:
        """Lay knots beyond the newest by its velocity and a fading acceleration."""
        last = self.step + 3
        step = self.knots[last - 1] - self.knots[last - 2]
        change = step - (self.knots[last - 2] - self.knots[last - 3])
        for k in range(last, last + 4):
            change = FADING * change
            step = step + change
            self.knots[k] = self.knots[k - 1] + step

    def _keyframe(self, step: int) -> float:
        """Merge the scans of a knot interval, and those just before; return its time, or inf."""
        begin, end = (step - 1) * self.h, step * self.h
        new = [s for s in self._scans if begin < s[1] <= end]
        if not new:
            return np.inf
        merged = [s for s in self._scans if begin - self.config.span < s[1] <= end]
        self._newest = np.concatenate([s[2] for s in new])
        # amid all its rays: an error of the velocity by which they are merged then does no harm
        moment = 0.5 * (merged[0][0] + merged[-1][1])
        rays = np.concatenate([s[2] for s in merged])
        slot = self.window.add(rays, moment, self.knots)
        if self.config.learn_error:
            frames = self.window.frames
            self.error.learn(
                frames.surfels[slot, :frames.counts[slot]],
                lambda: pieces(*merge(rays, self.knots, self.h, moment), rays),
                frames.pose[slot], self.window.travelled)
        self._scans = [s for s in self._scans if s[1] > end - self.config.span - self.h]
        return moment

    def _fit(
        self, first: int, last: int, newest: float, scales: Array, iterations: int,
    ) -> None:
        for _ in self._parts_of_fit(first, last, newest, scales, (0, iterations)):
            pass

    def _parts_of_fit(
        self, first: int, last: int, newest: float, scales: Array, bounds: tuple[int, ...],
    ) -> Iterator[bool]:
        """Solve; where the motion turned out different, build the keyframes again and solve."""
        window = self.window
        self.trust.reset()
        weights = self._weights()
        for begun, end in pairwise(bounds):
            self._solve(first, last, scales, newest, begun, end, weights)
            yield True
        again = window.build_again(self.knots, first * self.h)
        yield True
        if again:
            self._solve(first, last, scales[-2:], newest, 0, bounds[-1], weights)
        self._extrapolate()
        self.uncertainty.extend(self.knots, last, window.pairs, window.frames, newest)
        self.sigma = self._speed_sigma()
        if newest < np.inf:         # without a scan nobody has been asked
            window.seen_through(self._newest, self.knots, self.trust.through)
            window.testimony(self.error.value, self._forward, self.trust.testimony)
            self.trust.update(self._newest[:, LABEL], self.sigma < CERTAIN,
                              self.sigma < CLEAR and self.trust.agreement > AGREED)
        yield True

    def _speed_sigma(self) -> float:
        here, rest, covariance = np.zeros(3), np.empty((3, 3)), np.empty((3, 3))
        of_base(self.knots, self.h, self.step * self.h, self.uncertainty.covariance,
                self.uncertainty.first, here, here, np.empty(3), rest, np.empty(3), covariance)
        return speed_sigma(covariance)

    def _solve(
        self, first: int, last: int, scales: Array, newest: float, begun: int, iterations: int,
        weights: Array,
    ) -> None:
        p, f = self.window.pairs, self.window.frames
        n = p.count
        solve(
            self.knots, self.h, first, last, self._start, p.ends[:n], p.z[:n], p.hessian[:n],
            p.gradient[:n], p.passes[:n], f.time, f.pose, f.surfels, f.counts, f.bins, scales,
            newest, begun, iterations, self._jerk, self._acceleration, self._straight, self._slip,
            self.error.value, weights, self._forward, self.trust.votes,
            SLOW_DILUTION if self.slow else DILUTION)

    def _weights(self) -> Array:
        """Return the weight of each surface by number, one of scans too rare to follow any."""
        return self.trust.of_residuals() if self._judges else np.ones(len(self.trust.weight))


def _zeros(count: int) -> Array:
    """Return zeros (count, 3); those that are never written take no memory, however many."""
    return np.frombuffer(mmap.mmap(-1, 24 * count)).reshape(-1, 3)
