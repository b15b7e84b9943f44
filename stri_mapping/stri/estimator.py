# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The STRI estimator: horizontal scans in, velocity and path out, by the paper's five steps.

Two products: `add` answers at once for the newest scan, `take_refined` gives the same scans'
poses again when the window behind them is complete, final and slightly late.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stri_mapping import geometry
from stri_mapping.scan import Scan
from stri_mapping.stri.curves import Curves
from stri_mapping.stri.ego_motion import combine, Twist
from stri_mapping.stri.estimate import Estimate
from stri_mapping.stri.range_image import RangeImage
from stri_mapping.stri.segmentation import Edges, Segmenter
from stri_mapping.stri.start import propose_speed

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EstimatorConfig:
    """
    Settings of the estimator; every default is usable.

    Attributes
    ----------
    half_window
        Seconds before and after a moment over which curves are smoothed; the refined poses
        come this much late.  Slow scanners get at least `half_scans` scan periods.
    half_scans
        See `half_window`.
    start_window
        Seconds of scans from which the first speed is read, at least `half_scans` periods.
    degenerate_below
        Share of the forward speed's information from the curves below which the motion counts
        as not observable.
    image_window
        Seconds of the range image kept for pictures.

    """

    half_window: float = 0.5
    half_scans: int = 4
    start_window: float = 0.6
    degenerate_below: float = 0.5
    image_window: float = 8.0


class StriEstimator:
    """
    Motion of base_link from the scans of one horizontal scanner.

    Parameters
    ----------
    T_base_laser
        (4, 4) mount of the scanner; its scan plane is taken as horizontal.
    config
        Settings.

    """

    def __init__(self, T_base_laser: Array, config: EstimatorConfig | None = None) -> None:
        """Start with nothing known."""
        self.config = config or EstimatorConfig()
        self.range_image = RangeImage(self.config.image_window)
        self._R, self._t = T_base_laser[:2, :2], T_base_laser[:2, 3]
        self._origin_ns: int | None = None
        self._half = self.config.half_window
        self._curves = Curves()
        self._segmenter = Segmenter()
        self._starting: list[tuple[Scan, Edges]] = []
        self._pending: deque[int] = deque()      # stamps of scans whose refined pose is to come
        self._refined: list[Estimate] = []       # refined, not yet taken
        self._last: Estimate | None = None       # newest refined
        self._twist: Twist | None = None         # at `_last`
        self._newest: Twist | None = None        # at the newest scan
        self._lead: Array = np.zeros(3)          # motion from `_last` to the newest scan

    def warm_up(self) -> None:
        """Compile what is not in the cache, so that no scan has to wait for it."""
        angles = np.deg2rad(np.arange(0.0, 90.0))
        other = StriEstimator(np.eye(4), self.config)
        for i in range(150):
            ranges = np.where((np.arange(90) + i // 10) % 30 < 15, 5.0, 8.0)
            other.add(Scan(i * 13_320_000, ranges, angles, np.zeros(90)))
        other.finish()

    def add(self, scan: Scan) -> Estimate | None:
        """
        Take the next scan.

        Returns
        -------
        Estimate or None
            The low-latency estimate at the scan's stamp; None while starting up, for which
            `take_refined` makes up later.

        """
        labels, edges = self._segmenter.segment(scan)
        self.range_image.append(scan, labels)
        if self._origin_ns is None:
            self._origin_ns = scan.stamp_ns
        self._pending.append(scan.stamp_ns)
        if self._newest is None:
            self._starting.append((scan, edges))
            self._half = max(self.config.half_window, self.config.half_scans * self._period())
            if self._seconds(scan.stamp_ns) < max(self.config.start_window, self._half):
                return None
            return self._start()
        return self._advance(scan, edges)

    def take_refined(self) -> list[Estimate]:
        """Return the estimates that became final since the last call, in order, one a scan."""
        taken, self._refined = self._refined, []
        return taken

    def finish(self) -> None:
        """Make everything final: no scan will follow."""
        if self._newest is None and len(self._starting) > 1:
            self._start()
        while self._pending and self._newest is not None:
            self._refine(self._pending.popleft())

    def _seconds(self, stamp_ns: int) -> float:
        assert self._origin_ns is not None
        return (stamp_ns - self._origin_ns) * 1e-9

    def _period(self) -> float:
        stamps = [scan.stamp_ns for scan, _ in self._starting]
        return float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else np.inf

    def _start(self) -> Estimate:
        """Read the first speed from the slope of the range image, then take the scans kept."""
        speed, _ = propose_speed([s for s, _ in self._starting], self._R)
        self._newest = Twist(np.array([speed, 0.0, 0.0]), np.diag([0.3, 0.1, 0.3]) ** 2, 0.0, 0)
        kept, self._starting = self._starting, []
        estimates = [self._advance(scan, edges) for scan, edges in kept]
        return estimates[-1]

    def _advance(self, scan: Scan, edges: Edges) -> Estimate:
        assert self._newest is not None
        now = self._seconds(scan.stamp_ns)
        points = edges.points @ self._R.T + self._t
        self._curves.follow(now + edges.times, points, edges.sides, self._newest.value,
                            0.5 * self._half)
        while self._pending and self._seconds(self._pending[0]) + self._half <= now:
            self._refine(self._pending.popleft())
        return self._predict(scan.stamp_ns, now)

    def _predict(self, stamp_ns: int, now: float) -> Estimate:
        """Return the estimate at the newest scan, ahead of the last refined pose."""
        base = self._twist or self._newest
        assert base is not None
        since = now - (self._seconds(self._last.stamp_ns) if self._last else 0.0)
        states, sigmas = self._curves.slopes(now, now - self._half, now + 0.1)
        newest = combine(states, sigmas, base, since)
        self._newest = newest
        # over the half window the twist changes about linearly: its mean moves the vehicle
        lead = geometry.exp(0.5 * (base.value + newest.value) * since)
        start = self._last.pose if self._last else np.zeros(3)
        covariance = self._last.pose_covariance if self._last else np.zeros((3, 3))
        return self._estimate(stamp_ns, geometry.compose(start, lead), covariance, newest)

    def _refine(self, stamp_ns: int) -> None:
        """Make the pose at a scan's stamp final: step 5 of the paper, position by integration."""
        moment, half = self._seconds(stamp_ns), self._half
        states, sigmas = self._curves.slopes(moment, max(moment - half, 0.0), moment + half)
        if self._last is None:
            self._twist = combine(states, sigmas, self._newest, 0.0)
            pose, covariance = np.zeros(3), np.zeros((3, 3))
        else:
            assert self._twist is not None
            dt = moment - self._seconds(self._last.stamp_ns)
            twist = combine(states, sigmas, self._twist, dt)
            pose = geometry.compose(
                self._last.pose, geometry.exp(0.5 * (self._twist.value + twist.value) * dt))
            covariance = self._last.pose_covariance + twist.covariance * dt
            self._twist = twist
        self._last = self._estimate(stamp_ns, pose, covariance, self._twist)
        self._refined.append(self._last)

    def _estimate(self, stamp_ns: int, pose: Array, covariance: Array, twist: Twist) -> Estimate:
        return Estimate(stamp_ns, pose, covariance, twist.value, twist.covariance,
                        twist.observed, twist.observed < self.config.degenerate_below)
