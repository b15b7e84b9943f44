# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The path of the scanner over the sliding spatio-temporal buffer, estimated jointly.

Everything here is in the scanner's own plane: its pose over time is a spline (see `spline`),
scans are merged to keyframes (`keyframe`), keyframes are paired over time and distance
(`pairs`), and the newest knots are fitted to all of it (`smoother`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stri_mapping import geometry
from stri_mapping.stri import keyframe
from stri_mapping.stri.range_error import RangeError
from stri_mapping.stri.smoother import Keyframes, Pairs, solve
from stri_mapping.stri.trust import Trust
from stri_mapping.stri.spline import pose_at, velocity_at
from stri_mapping.stri.uncertainty import Uncertainty

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointConfig:
    """
    Settings of the joint fit.

    Attributes
    ----------
    active
        Knots that are still fitted; older ones are final.
    lags
        Keyframes back that a new one is paired with.
    distances
        Metres back along the path that a new one is paired with.
    span
        Seconds of scans merged in a keyframe besides those of its own knot interval.
    jerk, angular_jerk, acceleration, angular_acceleration
        Standard deviations of the motion's third and second derivatives, SI units.
    far
        Metres beyond which returns are not used.
    start_steps
        Knot intervals collected before the first fit.

    """

    active: int = 12
    lags: tuple[int, ...] = (1, 2, 4, 7)
    distances: tuple[float, ...] = (3.0, 6.0, 10.0)
    span: float = 0.1
    jerk: float = 6.0
    angular_jerk: float = 3.0
    acceleration: float = 4.0
    angular_acceleration: float = 2.0
    far: float = 80.0
    start_steps: int = 13
    iterations: int = 7
    learn_error: bool = True


SCALES = np.array([0.2, 0.1, 0.06, 0.04])
START_SCALES = np.array([0.25, 0.25, 0.12, 0.12, 0.06, 0.06, 0.04])
REBUILD_SHIFT, REBUILD_TURN = 0.0015, 0.0004
SLOTS, POINTS = 384, 2048
RAYS_PER_STRIDE = 1000       # rays of a keyframe of which every next one becomes a surfel
KEEP_EVERY = 0.05     # metres of path between keyframes kept for pairs over distance
RESTART = 8           # knot intervals laid anew when the motion is taken up again
CERTAIN = 0.25        # m/s, standard deviation of a speed that is known
KEEP_TIME = 400       # knot intervals after which a keyframe is too old


class JointPath:
    """
    The scanner's path in its first frame.

    Parameters
    ----------
    spacing
        Knot spacing in seconds.
    angle_step
        Radians between rays of a scan.
    forward
        (2,) direction of travel in the scanner frame.
    config
        Settings.

    """

    def __init__(self, spacing: float, angle_step: float, forward: Array, config: JointConfig) -> None:
        """Start with no scan."""
        self.h = spacing
        self.config = config
        self.knots = np.zeros((1024, 3))
        self.first = 0            # first knot still active
        self._start = 0           # knot at which the motion was taken up
        self.step = 0             # steps done: the spline is valid before step * h
        self.sigma = np.inf       # of the speed at the newest knot, m/s
        self.uncertainty = Uncertainty(spacing)
        self.error = RangeError()
        self.trust = Trust()
        self._forward = forward
        self._angle_step = angle_step
        self._scans: list[tuple[float, float, Array]] = []     # start, end, rays
        self._frames = Keyframes(SLOTS, POINTS)
        self._pairs = Pairs(8 * SLOTS)
        self._order: list[int] = []       # slots in use, oldest first
        self._free = list(range(SLOTS))
        self._odometer = np.zeros(SLOTS)
        self._built = np.zeros((SLOTS, 3))
        self._sources: dict[int, Array] = {}
        h, c = spacing, config
        self._jerk = np.array([c.jerk, c.jerk, c.angular_jerk]) ** -2.0 * h ** -6
        self._acceleration = np.array(
            [c.acceleration, c.acceleration, c.angular_acceleration]) ** -2.0 * h ** -4

    def add(self, start: float, end: float, rays: Array) -> None:
        """Take the prepared rays of a scan that lasted from start to end."""
        self._scans.append((start, end, rays))

    def begin(self, twist: Array) -> None:
        """Make the first fit, from a constant twist (3,) of the scanner in its own frame."""
        self.step = self.config.start_steps
        last = self.step + 3
        self.knots[:last] = geometry.exp(np.arange(last)[:, None] * self.h * twist)
        slots = [s for k in range(2, self.step + 1) if (s := self._keyframe(k)) is not None]
        self._fit(0, last, slots, START_SCALES, 14)
        self.first = max(0, last + 1 - self.config.active)

    def advance(self) -> None:
        """Extend the path by one knot interval, for which all scans must have been added."""
        self.step += 1
        last = self.step + 3
        if last + 4 > len(self.knots):
            self.knots = np.concatenate([self.knots, np.zeros_like(self.knots)])
        self.knots[last - 1] = 2.0 * self.knots[last - 2] - self.knots[last - 3]
        self.first = max(0, last - self.config.active)
        self._forget()
        slot = self._keyframe(self.step)
        self._fit(self.first, last, [] if slot is None else [slot], SCALES,
                  self.config.iterations)

    def restart(self, twist: Array) -> None:
        """
        Take up the motion again after losing it.

        Parameters
        ----------
        twist
            (3,) of the scanner in its own frame: the newest `RESTART` knot intervals are laid
            anew along it, from where the path was, and fitted to their own scans alone.

        """
        begin = self.step - RESTART
        anchor = self.pose(begin * self.h)
        steps = np.arange(RESTART + 3)
        self.knots[begin + 1:self.step + 4] = geometry.compose(
            anchor, geometry.exp(steps[:, None] * self.h * twist))
        self._pairs.count = 0
        times = self._frames.time
        kept = [s for s in self._order if s in self._sources and times[s] >= begin * self.h]
        self._free += [s for s in self._order if s not in kept]
        self._sources = {s: self._sources[s] for s in kept}
        self._order = []
        for slot in kept:
            self._build(slot)
            self._pair(slot)
            self._order.append(slot)
        self.trust.pardon()
        self._start = begin + 2
        self._fit(begin + 2, self.step + 3, kept, START_SCALES, 14)

    @property
    def final_until(self) -> float:
        """Time before which the path will not change any more."""
        return (self.first - 3) * self.h

    def pose(self, t: float) -> Array:
        """Return the pose (3,) at a time; just beyond the newest knot it is extrapolated."""
        self._extrapolate()
        pose = np.empty(3)
        pose_at(self.knots, self.h, t, np.empty(4), pose)
        return pose

    def velocity(self, t: float) -> Array:
        """Return the velocity (3,) at a time, in the frame of the first scan."""
        self._extrapolate()
        velocity = np.empty(3)
        velocity_at(self.knots, self.h, t, velocity)
        return velocity

    def _extrapolate(self) -> None:
        last = self.step + 3
        for k in range(last, last + 4):
            self.knots[k] = self.knots[k-1] + (self.knots[k-1]-self.knots[k-2]) + 0.7*((self.knots[k-1]-self.knots[k-2])-(self.knots[k-2]-self.knots[k-3]))

    def _keyframe(self, step: int) -> int | None:
        """Merge the scans of a knot interval, with those just before, and pair them."""
        begin, end = (step - 1) * self.h, step * self.h
        inside = [s for s in self._scans if s[1] <= end]
        new = [s for s in inside if s[1] > begin]
        if not new:
            return None
        merged = [s for s in inside if s[1] > begin - self.config.span]
        slot = self._free.pop()
        frames = self._frames
        frames.time[slot] = 0.5 * (new[0][0] + new[-1][1])
        self._sources[slot] = np.concatenate([rays for _, _, rays in merged])
        self._build(slot)
        self._pair(slot)
        if self.config.learn_error:
            self.error.learn(frames.surfels[slot, :frames.counts[slot]],
                             float(self._odometer[slot]))
        self._order.append(slot)
        self._scans = [s for s in self._scans if s[1] > end - self.config.span - self.h]
        return slot

    def _build(self, slot: int) -> None:
        frames = self._frames
        t = frames.time[slot]
        rays = self._sources[slot]
        stride = max(1, len(rays) // RAYS_PER_STRIDE)
        frames.counts[slot] = keyframe.build(
            rays, self.knots, self.h, t, self._angle_step, stride, frames.surfels[slot],
            frames.bins[slot])
        velocity_at(self.knots, self.h, t, self._built[slot])
        pose_at(self.knots, self.h, t, np.empty(4), frames.pose[slot])

    def _pair(self, slot: int) -> None:
        """Pair a new keyframe with earlier ones by time and by distance travelled."""
        order, frames, odometer = self._order, self._frames, self._odometer
        if order:
            newest = order[-1]
            odometer[slot] = odometer[newest] + np.hypot(
                *(frames.pose[slot] - frames.pose[newest])[:2])
        else:
            odometer[slot] = 0.0
        partners = {order[-lag] for lag in self.config.lags if lag <= len(order)}
        travelled = odometer[order] if order else np.zeros(0)
        for distance in self.config.distances:
            k = int(np.searchsorted(travelled, odometer[slot] - distance, side='right')) - 1
            if k >= 0:
                partners.add(order[k])
        for other in sorted(partners):
            self._pairs.add(slot, other)
            self._pairs.add(other, slot)

    def _forget(self) -> None:
        """Let go of pairs that touch no active knot and of keyframes no longer needed."""
        frames, pairs, order = self._frames, self._pairs, self._order
        times = frames.time[pairs.ends[:pairs.count]].max(axis=1, initial=-np.inf)
        pairs.keep(times >= (self.first - 3) * self.h)
        if not order:
            return
        odometer = self._odometer
        newest = odometer[order[-1]]
        reach = max(self.config.distances, default=0.0) + 1.0
        recent = set(order[-max(self.config.lags, default=1) - self.config.active:])
        used = recent | set(pairs.ends[:pairs.count].ravel().tolist())
        kept, at = [], -np.inf
        for slot in order:
            near = newest - odometer[slot] <= reach
            young = self.step * self.h - frames.time[slot] < KEEP_TIME * self.h
            if slot in used or (near and young and odometer[slot] - at >= KEEP_EVERY):
                kept.append(slot)
                at = odometer[slot]
            else:
                self._free.append(slot)
            if slot not in recent:
                self._sources.pop(slot, None)
        self._order = kept

    def _fit(self, first: int, last: int, new: list[int], scales: Array, iterations: int) -> None:
        """Solve; where the motion turned out different, build the keyframes again and solve."""
        newest = min((float(self._frames.time[s]) for s in new), default=np.inf)
        self.trust.votes[:] = 0.0
        for attempt in range(3):
            self._solve(first, last, scales if attempt == 0 else scales[-2:], newest, iterations)
            stale = [s for s in self._order
                     if s in self._sources and self._frames.time[s] >= first * self.h
                     and self._stale(s)]
            if not stale or attempt == 2:
                break
            for slot in stale:
                self._build(slot)
            ends = self._pairs.ends[:self._pairs.count]
            self._pairs.passes[:self._pairs.count][np.isin(ends, stale).any(axis=1)] = 0
        self.uncertainty.extend(self.knots, last, self._pairs, self._frames, newest)
        self.sigma = self.uncertainty.speed(self.step * self.h)
        self.trust.update(self.sigma < CERTAIN)

    def _solve(
        self, first: int, last: int, scales: Array, newest: float, iterations: int,
    ) -> None:
        p, f = self._pairs, self._frames
        n = p.count
        solve(
            self.knots, self.h, first, last, self._start, p.ends[:n], p.z[:n], p.hessian[:n],
            p.gradient[:n], p.passes[:n], f.time, f.pose, f.surfels, f.counts, f.bins, scales,
            newest, iterations, self._jerk, self._acceleration, self.error.value,
            self.trust.weight, self._forward, self.trust.votes)

    def _stale(self, slot: int) -> bool:
        now = np.empty(3)
        velocity_at(self.knots, self.h, self._frames.time[slot], now)
        change = 0.5 * self.h * np.abs(now - self._built[slot])
        return bool(np.hypot(change[0], change[1]) > REBUILD_SHIFT or change[2] > REBUILD_TURN)
