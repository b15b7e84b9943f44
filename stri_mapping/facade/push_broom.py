# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Push-broom alignment: every ray of the vertical scanners placed by the pose at its own time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stri_mapping import geometry
from stri_mapping.facade.drift import DriftCorrector
from stri_mapping.facade.free_space import FreeSpace
from stri_mapping.facade.ghosts import GhostFinder
from stri_mapping.facade.placing import full_poses, place, rays_of
from stri_mapping.facade.points import FacadePoints, NOISE, Rays
from stri_mapping.facade.stabiliser import Stabiliser
from stri_mapping.scan import Scan
from stri_mapping.trajectory import Trajectory
from stri_mapping.vehicle import Scanner

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

# Longest time between two poses that is bridged, seconds.  At street speed the twist of a car
# changes by 1 m/s or so in that time: beyond it a ray would be placed by guesswork.
MAX_POSE_GAP = 0.5
# How long scans and poses wait for each other, seconds of their stamps.  Refined poses come at
# most 2 s late; the rest is for a machine that falls behind.  It bounds the memory.
MAX_WAIT = 120.0
# Longest silence of a scanner that is waited for, seconds.
SILENCE = 2.0
# Scans placed in one go: a second of three scanners, so that few knot intervals are cut.
BATCH = 192


@dataclass
class AlignerCounts:
    """
    What became of the scans and rays so far.

    Every ray of every scan that was kept ends in exactly one of `points`, `no_return` and
    `outside` (no pose at its time), once its scan has been placed.  Of the points, `roll_told`
    and `pitch_told` were stabilised in roll and pitch: road or walls told them at that time;
    and of `yaw_told` walls that several scanners saw told the yaw.
    """

    scans: int = 0
    out_of_order: int = 0
    points: int = 0
    no_return: int = 0
    outside: int = 0
    roll_told: int = 0
    pitch_told: int = 0
    yaw_told: int = 0


class _Line(NamedTuple):
    """One scan that waits for its poses."""

    stamp_ns: int
    ring: int
    end_ns: int
    scan: Scan


class FacadeAligner:
    """
    Places vertical scan lines where the vehicle was: p_odom = T_odom_base(t) T_base_laser p_laser.

    Scans and final poses come in their own order of time, in any interleaving.  A scan waits
    for a pose at or after its last ray, then for the roll, pitch and heave that its own and the
    next second's lines tell (`stabiliser`), is placed, and forgotten.  The points are the same
    for every interleaving in which scans come before the poses they need.  A ray with no pose
    around it is counted and left out, never guessed: one before the first pose, after the last,
    or in a gap of more than `MAX_POSE_GAP`.

    Parameters
    ----------
    scanners
        The vertical scanners; the index of each is its ring.
    pivot
        (3,) the point of base_link whose way the planar poses tell, metres: for poses from the
        horizontal scanner, where that sits, since it moves when the body rolls and pitches.
    stabilise
        Whether roll, pitch and heave are estimated; else they are 0.

    """

    def __init__(self, scanners: Sequence[Scanner], pivot: ArrayLike = (0.0, 0.0, 0.0),
                 stabilise: bool = True) -> None:
        """Wait for scans and poses."""
        self.counts = AlignerCounts()
        self._T_base_laser = np.array([s.T_base_laser for s in scanners]).reshape(-1, 4, 4)
        self._pivot = np.array(pivot, dtype=float)    # in one piece, as `warm_up` has it
        self._stabiliser = Stabiliser(scanners)
        self._stabilise = stabilise
        self._free_space = FreeSpace(self._T_base_laser[:, :3, 3])
        self._ghosts = GhostFinder(scanners)
        self._drift = DriftCorrector(len(scanners) if stabilise else 0)
        self._last_stamps: list[int | None] = [None] * len(scanners)
        self._pose_when_heard = -np.inf         # newest pose when a scan last came
        self._waiting: list[_Line] = []
        self._surveyed: list[tuple[Rays, NDArray[np.uint8]]] = []
        self._poses = Trajectory(np.empty(0, np.int64), np.empty((0, 3)))
        self._new_poses: list[tuple[Stamps, Array]] = []
        self._untaken: list[tuple[Stamps, Array]] = []
        self._newest_pose: int | None = None
        self._finished = False

    def add_scan(self, ring: int, scan: Scan) -> None:
        """
        Take the next scan of one scanner.

        A scan whose stamp does not come after the one before it is counted and left out.

        Raises
        ------
        IndexError
            If there is no scanner of that ring.

        """
        last = self._last_stamps[ring]
        if last is not None and scan.stamp_ns <= last:
            self.counts.out_of_order += 1
            return
        self._last_stamps[ring] = scan.stamp_ns
        self._pose_when_heard = -np.inf if self._newest_pose is None else self._newest_pose
        self.counts.scans += 1
        self._waiting.append(_Line(scan.stamp_ns, ring, scan.end_ns, scan))

    def add_poses(self, stamps_ns: ArrayLike, poses: ArrayLike) -> None:
        """
        Take final poses of base_link in odom; repeated and older ones are ignored.

        Parameters
        ----------
        stamps_ns
            (n,) nanoseconds, increasing.
        poses
            (n, 3) as (x, y, yaw): metres, metres, radians.

        """
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        if self._newest_pose is not None:
            new = stamps > self._newest_pose
            stamps, poses = stamps[new], np.asarray(poses, dtype=float)[new]
        if len(stamps):
            self._new_poses.append((stamps, np.array(poses, dtype=float)))
            self._untaken.append(self._new_poses[-1])
            self._newest_pose = int(stamps[-1])

    def finish(self) -> None:
        """Make everything final: no scan and no pose will follow."""
        self._finished = True

    def warm_up(self) -> None:
        """Compile what is compiled at its first use, with lines that are then forgotten."""
        if not len(self._T_base_laser):
            return
        angles = np.linspace(-1.5, 1.5, 40)
        scans = [Scan(k * 10**8, np.full(40, 3.0), angles, np.zeros(40)) for k in range(20)]
        # two, since what compares scanners is not asked for with one
        trial = FacadeAligner([Scanner('', 'vertical', self._T_base_laser[0], '', '')] * 2)
        for k, scan in enumerate(scans):
            trial.add_scan(k % 2, scan)
        trial.add_poses([scan.stamp_ns for scan in scans], np.zeros((len(scans), 3)))
        trial.finish()
        trial.take_points()

    def take_points(self) -> FacadePoints:
        """
        Return the points that became final since the last call, each once.

        They are ordered by the stamp of their scan, then ring, then ray.  After `finish`,
        the call returns all that can be placed.
        """
        self._join_poses()
        ready, self._waiting = self._split_waiting()
        ready.sort(key=attrgetter('stamp_ns', 'ring'))
        for i in range(0, len(ready), BATCH):
            rays = self._rays(ready[i:i + BATCH])
            if len(rays):
                label = self._stabiliser.add(rays)
                self._ghosts.mark(rays, label)
                label[self._free_space.moving(rays)] = NOISE
                self._surveyed.append((rays, label))
        if self._finished:
            self._stabiliser.finish()
        elif self._newest_pose is not None:
            self._stabiliser.advance(self._known_ns(self._newest_pose))
        for rays, label in self._take_final():
            self._drift.add(self._place(rays, label), rays.poses, rays.first)
        begun = (int(rays.stamps_ns.min()) for rays, _ in self._surveyed)
        points = self._drift.take(min([self._final_ns(), *begun]))
        self.counts.yaw_told = self._drift.yaw_told
        return points

    def _known_ns(self, newest_pose: int) -> int:
        """
        Return the time up to which poses and scans have come.

        On a busy machine scans may be seconds behind their poses.  A scanner that is silent for
        longer than `SILENCE` while others are not, or all while the poses go on, is not waited
        for.
        """
        heard = [stamp for stamp in self._last_stamps if stamp is not None]
        if not heard or newest_pose - self._pose_when_heard > SILENCE * 1e9:
            return newest_pose
        return min(newest_pose, *(s for s in heard if s >= max(heard) - SILENCE * 1e9))

    def take_poses(self) -> tuple[Stamps, Array]:
        """
        Return the poses whose attitude became final since the last call, each once.

        To be called after `take_points`; after `finish` it returns all there are.

        Returns
        -------
        stamps_ns : Stamps
            (n,) nanoseconds, those of `add_poses`.
        poses : Array
            (n, 6) of base_link in odom: x, y, z in metres, roll, pitch, yaw in radians.

        """
        stamps = np.concatenate([np.empty(0, np.int64), *(s for s, _ in self._untaken)])
        poses = np.concatenate([np.empty((0, 3)), *(p for _, p in self._untaken)])
        count = int(np.searchsorted(stamps, self._drift.final_ns(self._final_ns())))
        self._untaken = [(stamps[count:], poses[count:])]
        attitude, _ = self._attitude(stamps[:count])
        corrected = geometry.compose(poses[:count], self._drift.at(stamps[:count]))
        return stamps[:count], full_poses(corrected, attitude, self._pivot)

    def _final_ns(self) -> float:
        """Return the time before which attitudes are final."""
        if self._finished or not self._stabilise or self._newest_pose is None:
            return np.inf
        final = self._stabiliser.final_ns
        # without lines there is nothing to wait for but the lines themselves
        return self._newest_pose - 1e9 if final is None else final

    def _take_final(self) -> list[tuple[Rays, NDArray[np.uint8]]]:
        """Return the lines whose attitude is final."""
        final = np.inf if self._stabiliser.final_ns is None else self._final_ns()
        count = 0
        while count < len(self._surveyed) and self._surveyed[count][0].stamps_ns.max() < final:
            count += 1
        taken, self._surveyed = self._surveyed[:count], self._surveyed[count:]
        return taken

    def _join_poses(self) -> None:
        """Append the poses that came and drop those that no scan will ask for."""
        if not self._new_poses or self._newest_pose is None:
            return
        stamps = np.concatenate([self._poses.stamps_ns, *(s for s, _ in self._new_poses)])
        poses = np.concatenate([self._poses.poses, *(p for _, p in self._new_poses)])
        oldest = self._newest_pose - int(MAX_WAIT * 1e9)
        oldest = min([oldest, *(line.stamp_ns for line in self._waiting)])
        # one pose before the oldest ray is still needed to place it
        keep = max(int(np.searchsorted(stamps, oldest, side='right')) - 1, 0)
        self._poses = Trajectory(stamps[keep:], poses[keep:])
        self._stabiliser.forget(oldest)
        self._new_poses.clear()

    def _split_waiting(self) -> tuple[list[_Line], list[_Line]]:
        """Return the lines that can be placed or have waited too long, and the others."""
        if self._finished:
            return self._waiting, []
        known = -np.inf if self._newest_pose is None else self._newest_pose
        newest = max((line.stamp_ns for line in self._waiting), default=0)
        limit = max(known, newest - MAX_WAIT * 1e9)
        ready = [line for line in self._waiting if line.end_ns <= limit]
        return ready, [line for line in self._waiting if line.end_ns > limit]

    def _rays(self, lines: Sequence[_Line]) -> Rays:
        """Return the rays of some lines; those without return or pose are counted, left out."""
        rays, no_return, outside = rays_of(
            [line.scan for line in lines], [line.ring for line in lines], self._T_base_laser,
            self._poses, MAX_POSE_GAP)
        self.counts.no_return += no_return
        self.counts.outside += outside
        self.counts.points += len(rays)
        return rays

    def _attitude(self, stamps: Stamps) -> tuple[Array, NDArray[np.bool_]]:
        if not self._stabilise:
            return np.zeros((len(stamps), 3)), np.zeros((len(stamps), 2), dtype=bool)
        return self._stabiliser.at(stamps)

    def _place(self, rays: Rays, label: NDArray[np.uint8]) -> FacadePoints:
        """Place rays whose attitude is final."""
        attitude, told = self._attitude(rays.stamps_ns)
        self.counts.roll_told += int(np.count_nonzero(told[:, 0]))
        self.counts.pitch_told += int(np.count_nonzero(told[:, 1]))
        xyz = place(rays.base, rays.poses, attitude, self._pivot)
        return FacadePoints(xyz, rays.intensity, rays.stamps_ns, rays.ring, label)
