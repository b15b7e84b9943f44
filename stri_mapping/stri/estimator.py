# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The STRI estimator: horizontal scans in, velocity and path out, by the paper's five steps.

Two products: `add` answers at once for the newest scan, `take_refined` gives the same scans'
poses again when they are final, at most two seconds later.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stri_mapping import geometry
from stri_mapping.scan import Scan
from stri_mapping.stri.beat import Beat
from stri_mapping.stri.config import EstimatorConfig
from stri_mapping.stri.estimate import Estimate, of_base, speed_sigma
from stri_mapping.stri.joint import JointPath
from stri_mapping.stri.proposal import Profile, SlopeSearch
from stri_mapping.stri.range_error import RangeError
from stri_mapping.stri.range_image import RangeImage, RangeImageLog
from stri_mapping.stri.rays import prepare_rays, RAY
from stri_mapping.stri.recovery import changed_twist, Recovery
from stri_mapping.stri.segmentation import Labels, Segmenter

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RECENT = 0.64               # seconds of scans kept for proposing a motion
TAKE_UP_EVERY = 3           # knot intervals between looks for a lost motion
DOUBT = 0.4                 # share of votes for the motion below which it is doubted
ALONE = 0.8                 # share of them that one surface has, above which it is doubted, too


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
        self.range_image_log = RangeImageLog()
        self._mount = geometry.planar_pose(T_base_laser)
        self._handed = 1.0 if T_base_laser[2, 2] > 0.0 else -1.0    # -1: mounted upside down
        self._segmenter = Segmenter()
        self._starting: list[tuple[Scan, Labels, float]] = []      # with times, see `Beat`
        self._search = SlopeSearch(self._mount)  # of the motion at the start
        self._beat = Beat()
        self._pending: deque[tuple[int, float]] = deque()    # scans whose final pose is to come
        self._refined: list[Estimate] = []       # final, not yet taken
        self._path: JointPath | None = None
        self._advanced = False                   # whether the scan before extended the path
        self._looks = False                      # whether a look for the motion is due
        self._found: tuple[Array, float] | None = None      # another motion, to be taken up
        self._restart: Iterator[bool] = iter(())            # what is left of taking it up
        self._profiles: deque[Profile] = deque()
        self._recovery = Recovery(self._mount)
        self._origin_ns: int | None = None
        self._T_odom_first = np.zeros(3)         # odom from the path's own frame

    def warm_up(self) -> None:
        """Compile what is not in the cache, so that no scan has to wait for it."""
        angles = np.deg2rad(np.arange(0.0, 180.0))
        other = StriEstimator(np.eye(4), self.config)
        for i in range(150):
            ranges = np.where((np.arange(180) + i // 10) % 30 < 15, 5.0, 8.0)
            other.add(Scan(i * 13_320_000, ranges, angles, np.zeros(180)))
        other.finish()

    @property
    def footprint_pull(self) -> float:
        """By how much ranges fall short on slanted surfaces, 1/m, as learnt so far."""
        joint = self.config.joint
        error = (RangeError(joint.pull, joint.pull_sigma, joint.pulls) if self._path is None
                 else self._path.error)
        return error.value

    def add(self, scan: Scan) -> Estimate | None:
        """
        Take the next scan.

        Returns
        -------
        Estimate or None
            The low-latency estimate at the scan's stamp; None while starting up, for which
            `take_refined` makes up later.

        """
        labels = self._segmenter.segment(scan)
        self.range_image.append(scan, labels)
        self.range_image_log.append(scan, labels)
        if self._origin_ns is None:
            self._origin_ns = scan.stamp_ns
        time = self._beat.add((scan.stamp_ns - self._origin_ns) * 1e-9)
        self._pending.append((scan.stamp_ns, time))
        if self._path is None:
            self._starting.append((scan, labels, time))
            self._search.add(self._profile(scan, time))
            if not self._ready():
                return None
            if self._found is None:             # the fit goes with the next scan
                self._found = self._search.best()[0], 0.0
                return None
            self._start()
        else:
            self._path.trust.add(self._segmenter.surfaces)
            self._take(scan, labels, time)
        return self._estimate(*self._pending[-1])

    def take_refined(self) -> list[Estimate]:
        """Return the estimates that became final since the last call, in order, one a scan."""
        taken, self._refined = self._refined, []
        return taken

    def finish(self) -> None:
        """Make everything final: no scan will follow."""
        if self._path is None and len(self._starting) > 3:
            self._start()
        if self._path is None:
            return
        self._finish_restart()
        path = self._path
        while self._pending and (path.step - 1) * path.h <= self._pending[-1][1]:
            path.advance()
        self._release(np.inf)

    def _spacing(self) -> float:
        # the longer of two: some stamps wait for each other, others have not begun to be late
        between = np.diff([time for _, _, time in self._starting])
        period = max(float(between.mean()), float(np.median(between)))
        return max(self.config.knot_spacing, period)

    def _ready(self) -> bool:
        span = self._starting[-1][2] - self._starting[0][2]
        return len(self._starting) > 5 and (
            span > (self.config.joint.start_steps - 1) * self._spacing())

    def _start(self) -> None:
        """Read the first speed from the slope of the range image, then fit the scans kept."""
        twist = self._found[0] if self._found else self._search.best()[0]
        self._found = None
        angles = self._starting[0][0].angles
        step = float(abs(angles[1] - angles[0]))
        self._path = path = JointPath(
            self._spacing(), step, self._mount, self.config.joint)
        path.trust.add(self._segmenter.surfaces)
        path.trust.pardon()
        kept, self._starting = self._starting, []
        begun = False
        for scan, labels, time in kept:
            rays, start, end = self._prepare(scan, labels, time)
            if not begun and end > self.config.joint.start_steps * path.h:
                begun = True
                path.begin(self._of_scanner(twist))
            while begun and end > (path.step + 1) * path.h:
                path.advance()
            path.add(start, end, rays)
        if not begun:
            path.begin(self._of_scanner(twist))
        first = geometry.compose(path.pose(path.h), geometry.inverse(self._mount))
        self._T_odom_first = geometry.inverse(first)

    def _of_scanner(self, twist: Array) -> Array:
        """Return the scanner's own twist when base_link has a twist (3,)."""
        lever = twist + twist[2] * np.array([-self._mount[1], self._mount[0], 0.0])
        return np.asarray(geometry.rotation_from_rpy(0.0, 0.0, -self._mount[2]) @ lever)

    def _profile(self, scan: Scan, time: float, moves: Mask | None = None) -> Profile:
        """Return a scan as `SlopeSearch` takes it, without the rays on what is known to move."""
        ranges = np.where(scan.valid, scan.ranges, np.nan)
        if moves is not None:
            ranges[moves] = np.nan
        rising = not len(scan) or self._handed * (scan.angles[-1] - scan.angles[0]) > 0.0
        order = slice(None, None, 1 if rising else -1)
        return time, self._handed * scan.angles[order], ranges[order]

    def _prepare(self, scan: Scan, labels: Labels, time: float) -> tuple[Array, float, float]:
        assert self._path is not None
        start = time + self._path.h       # the spline's clock is one knot ahead of the first scan
        rays = np.empty((len(scan), RAY))
        brightness = np.full(len(scan), np.nan) if scan.intensities is None else scan.intensities
        ranges = np.where(scan.valid, scan.ranges, np.inf)
        angles = self._handed * scan.angles
        n = prepare_rays(ranges, angles, scan.times, labels, brightness, start,
                         self.config.joint.far, rays)
        return rays[:n], start, start + (float(scan.times.max()) if len(scan) else 0.0)

    def _take(self, scan: Scan, labels: Labels, time: float) -> None:
        assert self._path is not None
        rays, start, end = self._prepare(scan, labels, time)
        advances = end > (self._path.step + 1) * self._path.h
        change = None
        if advances:
            self._finish_restart()
            change = self._change()
        while end > (self._path.step + 1) * self._path.h:
            self._path.advance(change)
            change = None           # no scan is in a second interval
            self._looks |= self._path.step % TAKE_UP_EVERY == 0
        if not advances or self._advanced:      # a slow scanner advances with every scan
            self._take_up()
        self._advanced = advances
        self._path.add(start, end, rays)
        self._profiles.append(self._profile(scan, time, self._path.moving(labels)))
        while self._profiles[0][0] < self._profiles[-1][0] - RECENT:
            self._profiles.popleft()
        self._release(self._path.final_until)

    def _change(self) -> Array | None:
        """Return the scanner's twist as the newest two scans tell it, where scans are rare."""
        assert self._path is not None
        if not self._path.slow or len(self._profiles) < 3:
            return None
        recent = list(self._profiles)[-3:]
        now = self._estimate(0, recent[-1][0]).twist       # the newest scan may be far ahead
        twist = changed_twist(recent, self._mount, now)
        return None if twist is None else self._of_scanner(twist)

    def _take_up(self) -> None:
        """
        When the motion is not known, look whether the newest scans tell another one.

        The search, and the parts of the fit of what it has found, go with different scans, so
        that none has to wait for long.
        """
        assert self._path is not None
        if next(self._restart, False):
            return
        if self._found is not None:
            twist, acceleration = self._found
            self._restart = self._path.restart(
                self._of_scanner(twist), self._of_scanner(np.array([acceleration, 0.0, 0.0])))
            self._found = None
            if self._path.slow:                 # there is time for all of it
                self._finish_restart()
            else:
                next(self._restart)
        elif self._looks:
            self._looks = False
            self._found = self._another_motion()

    def _finish_restart(self) -> None:
        for _ in self._restart:
            pass

    def _another_motion(self) -> tuple[Array, float] | None:
        """Return twist and acceleration of a motion that is to replace the path's, if any."""
        assert self._path is not None
        sigma, trust = self._path.sigma, self._path.trust
        doubted = trust.agreement < DOUBT or (trust.alone > ALONE and not self._path.slow)
        lost = sigma > self.config.lost_sigma or doubted
        if not lost and self._recovery.confirmed:
            return None
        end, begin = self._pending[-1][1], self._profiles[0][0]
        now, before = (self._estimate(0, time).twist for time in (end, begin))
        gain = (now[0] - before[0]) / max(end - begin, self._path.h)
        return self._recovery.another_motion(
            list(self._profiles), now, gain, sigma, doubted)

    def _release(self, until: float) -> None:
        assert self._path is not None
        while self._pending and self._pending[0][1] + self._path.h < until:
            self._refined.append(self._estimate(*self._pending.popleft()))

    def _estimate(self, stamp_ns: int, time: float) -> Estimate:
        """Return pose and twist of base_link from the path of the scanner."""
        assert self._path is not None
        pose, twist = np.empty(3), np.empty(3)
        pose_covariance, twist_covariance = np.empty((3, 3)), np.empty((3, 3))
        known = self._path.uncertainty
        of_base(self._path.knots, self._path.h, time + self._path.h, known.covariance, known.first,
                self._mount, self._T_odom_first, pose, pose_covariance, twist,
                twist_covariance)
        sigma = speed_sigma(twist_covariance)
        limit = self.config.degenerate_sigma
        return Estimate(stamp_ns, pose, pose_covariance, twist, twist_covariance,
                        1.0 / (1.0 + (sigma / limit) ** 2), sigma > limit)
