# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The sliding buffer of keyframes: which there are, and which are compared with which."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri import keyframe
from stri_mapping.stri.edges import EDGES
from stri_mapping.stri.pairs import relative, testify
from stri_mapping.stri.sight import count_left, count_through
from stri_mapping.stri.spline import pose_at, velocity_at
from stri_mapping.stri.surfel import SURFEL

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SLOTS, POINTS = 384, 2048     # keyframes kept at most, and surfels of each
RAYS_PER_STRIDE = 1000        # rays of a keyframe of which every next one becomes a surfel
SEEN_THROUGH = (2, 4, 7, 12)            # keyframes back
TESTIFY = (4, 7)                        # keyframes back
APART = 0.06                  # metres, Geman-McClure scale of what surfaces say apart
RAYS_ASKED, SURFELS_ASKED = 3, 2        # every so many
KEEP_EVERY = 0.05             # metres of path between keyframes kept for pairs over distance
KEEP_SECONDS = 35.0           # after which a keyframe is too old for a pair: less than SLOTS knots
OVERLAP = 0.75                # seconds of keyframes kept before those that are built again
STALE_SHIFT, STALE_TURN = 0.003, 0.0008     # m, rad by which rays of a keyframe are misplaced


@dataclass(eq=False)
class Keyframes:
    """
    Keyframes in numbered slots, allocated once; the reflectance edges of one are `SLOTS` further.

    Attributes
    ----------
    surfels, counts, bins
        (2 slots, m, SURFEL), (2 slots,), (2 slots, BINS + 1), see `keyframe.build`.
    time
        (2 slots,) seconds on the spline's clock.
    pose
        (2 slots, 3) newest pose of the scanner.
    sight
        (slots, SIGHTS), see `keyframe.look`.

    """

    surfels: Array = field(
        default_factory=lambda: np.zeros((2 * SLOTS, POINTS, SURFEL)))
    counts: Index = field(default_factory=lambda: np.zeros(2 * SLOTS, np.int64))
    bins: NDArray[np.int32] = field(
        default_factory=lambda: np.zeros((2 * SLOTS, keyframe.BINS + 1), np.int32))
    sight: Array = field(default_factory=lambda: np.zeros((SLOTS, keyframe.SIGHTS)))
    time: Array = field(default_factory=lambda: np.zeros(2 * SLOTS))
    pose: Array = field(default_factory=lambda: np.zeros((2 * SLOTS, 3)))


@dataclass(eq=False)
class Pairs:
    """
    Condensed pairs of keyframes; the first `count` rows are in use.

    Attributes
    ----------
    ends
        (n, 2) slots of keyframes a and b.
    z, hessian, gradient
        (n, 3) pose of a in b at which the pair was linearised, (n, 3, 3), (n, 3).
    passes
        (n,) how often it was linearised; 0 forces the next.

    """

    count: int = 0
    ends: Index = field(default_factory=lambda: np.zeros((16 * SLOTS, 2), np.int64))
    z: Array = field(default_factory=lambda: np.zeros((16 * SLOTS, 3)))
    hessian: Array = field(default_factory=lambda: np.zeros((16 * SLOTS, 3, 3)))
    gradient: Array = field(default_factory=lambda: np.zeros((16 * SLOTS, 3)))
    passes: Index = field(default_factory=lambda: np.zeros(16 * SLOTS, np.int64))

    def add(self, a: int, b: int) -> None:
        """Add the pair a, b, to be linearised."""
        self.ends[self.count] = a, b
        self.passes[self.count] = 0
        self.count += 1

    def keep(self, mask: Mask) -> None:
        """Drop the pairs that the mask (count,) does not keep."""
        rows = np.flatnonzero(mask)
        for column in (self.ends, self.z, self.hessian, self.gradient, self.passes):
            column[:len(rows)] = column[rows]
        self.count = len(rows)

    def renew(self, slots: list[int]) -> None:
        """Have all pairs with one of these keyframes linearised again."""
        self.passes[:self.count][np.isin(self.ends[:self.count] % SLOTS, slots).any(axis=1)] = 0


class Window:
    """
    Keyframes and pairs over the newest stretch of the path.

    Parameters
    ----------
    spacing
        Knot spacing of the spline in seconds.
    angle_step
        Radians between rays of a scan.
    lags
        Keyframes back that a new one is paired with.
    distances
        Metres back along the path that a new one is paired with.
    recent
        Keyframes, counted back from the newest, that may have to be built again.

    """

    def __init__(
        self, spacing: float, angle_step: float, lags: tuple[int, ...],
        distances: tuple[float, ...], recent: int,
    ) -> None:
        """Start empty."""
        self.frames, self.pairs = Keyframes(), Pairs()
        self.order: list[int] = []                 # slots in use, oldest first
        self.travelled = 0.0                       # metres of path to the newest keyframe
        self._h, self._angle_step = spacing, angle_step
        self._lags, self._distances, self._recent = lags, distances, recent + max(lags)
        self._free = list(range(SLOTS))
        self._odometer = np.zeros(SLOTS)
        self._velocity = np.zeros((SLOTS, 3))      # with which each was built
        self._rays: dict[int, Array] = {}          # of those that may be built again

    def add(self, rays: Array, moment: float, knots: Array) -> int:
        """Merge prepared rays (n, RAY) to a keyframe at a moment; pair it; return its slot."""
        slot = self._free.pop()
        self._rays[slot] = rays
        self.frames.time[[slot, slot + SLOTS]] = moment
        self._admit(slot, knots)
        return slot

    def _admit(self, slot: int, knots: Array) -> None:
        self.build(slot, knots)
        if self.order:
            self.travelled += float(np.hypot(
                *(self.frames.pose[slot] - self.frames.pose[self.order[-1]])[:2]))
        self._odometer[slot] = self.travelled
        for other in sorted(self._partners()):
            self._pair(slot, other)
        self.order.append(slot)

    def _pair(self, a: int, b: int) -> None:
        """Compare two keyframes both ways, and their edges, if both have some."""
        self.pairs.add(a, b)
        self.pairs.add(b, a)
        frames = self.frames
        if frames.counts[a + SLOTS] and frames.counts[b + SLOTS]:
            frames.pose[[a + SLOTS, b + SLOTS]] = frames.pose[[a, b]]
            self.pairs.add(a + SLOTS, b + SLOTS)
            self.pairs.add(b + SLOTS, a + SLOTS)

    def _partners(self) -> set[int]:
        """Return the slots that a keyframe at the end of the path is compared with."""
        partners = {self.order[-lag] for lag in self._lags if lag <= len(self.order)}
        passed = self._odometer[self.order]
        for distance in self._distances:
            k = int(np.searchsorted(passed, self.travelled - distance, side='right')) - 1
            if k >= 0:
                partners.add(self.order[k])
        return partners

    def build(self, slot: int, knots: Array) -> None:
        """Put the rays of a keyframe where the spline says, and fit its lines."""
        frames, rays = self.frames, self._rays[slot]
        t = frames.time[slot]
        edges = slot + SLOTS
        frames.counts[slot], frames.counts[edges] = keyframe.build(
            rays, knots, self._h, t, self._angle_step, max(1, len(rays) // RAYS_PER_STRIDE),
            frames.surfels[slot], frames.bins[slot], frames.surfels[edges, :EDGES],
            frames.bins[edges], frames.sight[slot])
        velocity_at(knots, self._h, t, self._velocity[slot])
        pose_at(knots, self._h, t, np.empty(4), frames.pose[slot])

    def seen_through(self, rays: Array, knots: Array, votes: Array) -> None:
        """Count, by label, what came to or left a place through which another keyframe sees."""
        if not self.order:
            return
        f, z = self.frames, np.empty(3)
        newest = self.order[-1]
        for lag in SEEN_THROUGH:
            if lag < len(self.order):
                slot = self.order[-1 - lag]
                count_through(rays, RAYS_ASKED, knots, self._h, f.pose[slot], f.sight[slot], votes)
                relative(f.pose[slot], f.pose[newest], z)
                count_left(f.surfels[slot], f.counts[slot], SURFELS_ASKED, z, f.sight[newest],
                           votes)

    def testimony(self, pull: float, forward: Array, testimony: Array) -> None:
        """Add what each surface in the newest keyframe says apart, see `pairs.testify`."""
        f, z = self.frames, np.empty(3)
        for lag in TESTIFY:
            if lag < len(self.order):
                a, b = self.order[-1], self.order[-1 - lag]
                relative(f.pose[a], f.pose[b], z)
                testify(f.surfels[a], f.counts[a], f.surfels[b], f.counts[b], f.bins[b], z,
                        APART, SURFELS_ASKED, pull, forward, testimony)

    def build_again(self, knots: Array, begin: float) -> bool:
        """Build anew the keyframes since a time that had another motion; tell if there are any."""
        stale = [slot for slot in self.order
                 if slot in self._rays and self.frames.time[slot] >= begin
                 and self._misplaced(slot, knots)]
        for slot in stale:
            self.build(slot, knots)
        if stale:
            self.pairs.renew(stale)
        return bool(stale)

    def _misplaced(self, slot: int, knots: Array) -> bool:
        now = np.empty(3)
        velocity_at(knots, self._h, self.frames.time[slot], now)
        change = 0.5 * self._h * np.abs(now - self._velocity[slot])
        return bool(np.hypot(change[0], change[1]) > STALE_SHIFT or change[2] > STALE_TURN)

    def forget(self, begin: float) -> None:
        """Let go of pairs wholly before a time, and of keyframes no longer needed."""
        frames, pairs, order = self.frames, self.pairs, self.order
        pairs.keep(frames.time[pairs.ends[:pairs.count]].max(axis=1, initial=-np.inf) >= begin)
        recent = set(order[-self._recent:])
        used = recent | set((pairs.ends[:pairs.count] % SLOTS).ravel().tolist())
        reach = max(self._distances, default=0.0) + 1.0
        kept, at = [], -np.inf
        for slot in order:
            near = (self.travelled - self._odometer[slot] <= reach
                    and begin - frames.time[slot] < KEEP_SECONDS)
            if slot in used or (near and self._odometer[slot] - at >= KEEP_EVERY):
                kept.append(slot)
                at = self._odometer[slot]
            else:
                self._free.append(slot)
            if slot not in recent:
                self._rays.pop(slot, None)
        self.order = kept

    def rebuild(self, begin: float, knots: Array) -> float:
        """
        Build and pair anew the keyframes since a time; return the first's time.

        Of those before it only the last stay, to be paired with.
        """
        f = self.frames.time
        before = [s for s in self.order if begin - OVERLAP <= f[s] < begin]
        again = [s for s in self.order if s in self._rays and f[s] >= begin]
        self._free += [s for s in self.order if s not in before and s not in again]
        self._rays = {s: self._rays[s] for s in again}
        self.pairs.count = 0
        self.order = before
        if before:
            self.travelled = float(self._odometer[before[-1]])
        for slot in again:
            self._admit(slot, knots)
        return float(f[again[0]]) if again else np.inf
