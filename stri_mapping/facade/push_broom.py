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
from stri_mapping.scan import Scan
from stri_mapping.trajectory import constant_speed, Trajectory
from stri_mapping.vehicle import Scanner

Array = NDArray[np.float64]

# Longest time between two poses that is bridged, seconds.  At street speed the twist of a car
# changes by 1 m/s or so in that time: beyond it a ray would be placed by guesswork.
MAX_POSE_GAP = 0.5
# How long scans and poses wait for each other, seconds of their stamps.  Refined poses come at
# most 2 s late; the rest is for a machine that falls behind.  It bounds the memory.
MAX_WAIT = 120.0
# Scans placed in one go: some 9 000 rays, whose arrays stay in a core's cache.
BATCH = 48


@dataclass(frozen=True, eq=False)
class FacadePoints:
    """
    Points of the facades, one a ray that hit something.

    Attributes
    ----------
    xyz
        (n, 3) metres in odom; always finite.
    intensity
        (n,) float32 in the scanner's units; 0 where it gives none.
    stamps_ns
        (n,) int64 time of each ray in nanoseconds.
    ring
        (n,) uint16 index of the scanner among the vertical ones.

    """

    xyz: Array
    intensity: NDArray[np.float32]
    stamps_ns: NDArray[np.int64]
    ring: NDArray[np.uint16]

    def __len__(self) -> int:
        """Return the number of points, which may be 0."""
        return len(self.xyz)


def concatenate(pieces: Sequence[FacadePoints]) -> FacadePoints:
    """Return all points of some pieces, in order; none for no pieces."""
    return FacadePoints(
        np.concatenate([np.empty((0, 3)), *(p.xyz for p in pieces)]),
        np.concatenate([np.empty(0, np.float32), *(p.intensity for p in pieces)]),
        np.concatenate([np.empty(0, np.int64), *(p.stamps_ns for p in pieces)]),
        np.concatenate([np.empty(0, np.uint16), *(p.ring for p in pieces)]))


@dataclass
class AlignerCounts:
    """
    What became of the scans and rays so far.

    Every ray of every scan that was kept ends in exactly one of `points`, `no_return` and
    `outside` (no pose at its time), once its scan has been placed.
    """

    scans: int = 0
    out_of_order: int = 0
    points: int = 0
    no_return: int = 0
    outside: int = 0


class _Line(NamedTuple):
    """One scan that waits for its poses."""

    stamp_ns: int
    ring: int
    end_ns: int
    scan: Scan


class FacadeAligner:
    """
    Places vertical scan lines where the vehicle was: p_odom = T_odom_base(t) T_base_laser p_laser.

    Scans and final poses come in their own order of time, in any interleaving; the points are
    the same for every interleaving, and so is their order for scans that arrive before the
    poses they need.  A scan is placed once there is a pose at or after its last ray, and is then
    forgotten.  A ray with no pose around it is counted and left out, never guessed: one before
    the first pose, after the last, or in a gap of more than `MAX_POSE_GAP`.
    """

    def __init__(self, scanners: Sequence[Scanner]) -> None:
        """Take the vertical scanners; the index of each is its ring."""
        self.counts = AlignerCounts()
        self._T_base_laser = np.array([s.T_base_laser for s in scanners]).reshape(-1, 4, 4)
        self._last_stamps: list[int | None] = [None] * len(scanners)
        self._waiting: list[_Line] = []
        self._poses = Trajectory(np.empty(0, np.int64), np.empty((0, 3)))
        self._new_poses: list[tuple[NDArray[np.int64], Array]] = []
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
            self._newest_pose = int(stamps[-1])

    def finish(self) -> None:
        """Make everything final: no scan and no pose will follow."""
        self._finished = True

    def take_points(self) -> FacadePoints:
        """
        Return the points that became final since the last call, each once.

        They are ordered by the stamp of their scan, then ring, then ray.  After `finish`,
        the call returns all that can be placed.
        """
        self._join_poses()
        ready, self._waiting = self._split_waiting()
        ready.sort(key=attrgetter('stamp_ns', 'ring'))
        return concatenate([self._place(ready[i:i + BATCH]) for i in range(0, len(ready), BATCH)])

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

    def _place(self, lines: Sequence[_Line]) -> FacadePoints:
        """Place some scan lines; rays without return or without a pose are counted, left out."""
        scans = [line.scan for line in lines]
        counts = [len(scan) for scan in scans]
        hit = np.concatenate([scan.valid for scan in scans])
        stamps = np.repeat([scan.stamp_ns for scan in scans], counts)[hit]
        stamps += np.rint(_join(scans, 'times')[hit] * 1e9).astype(np.int64)
        poses = self._poses.at(stamps, MAX_POSE_GAP)
        known = ~np.isnan(poses[:, 0])
        self.counts.no_return += len(hit) - len(stamps)
        self.counts.outside += len(stamps) - int(np.count_nonzero(known))
        self.counts.points += int(np.count_nonzero(known))
        hit[hit] = known
        ring = np.repeat([line.ring for line in lines], counts)[hit]
        base = self._in_base(_join(scans, 'ranges')[hit], _join(scans, 'angles')[hit], ring)
        return FacadePoints(from_base(poses[known], base), _intensity(scans)[hit], stamps[known],
                            ring.astype(np.uint16))

    def _in_base(self, ranges: Array, angles: Array, ring: NDArray[np.intp]) -> Array:
        """Return rays (n,) of the scan planes as points (n, 3) of base_link."""
        x, y = ranges * np.cos(angles), ranges * np.sin(angles)
        rows = self._T_base_laser[:, :3].transpose(1, 2, 0)
        return np.stack([x * r[0][ring] + y * r[1][ring] + r[3][ring] for r in rows], axis=1)


def _join(scans: Sequence[Scan], field: str) -> Array:
    return np.concatenate([getattr(scan, field) for scan in scans])


def _intensity(scans: Sequence[Scan]) -> NDArray[np.float32]:
    """Return the intensity of every ray; 0 where the scanner gives none."""
    given = [np.zeros(len(s)) if s.intensities is None else s.intensities for s in scans]
    return np.nan_to_num(np.concatenate(given)).astype(np.float32)


def from_base(poses: Array, points: Array) -> Array:
    """Return points (n, 3) of base_link in odom, each by its own planar pose (n, 3)."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y, z = points.T
    return np.stack([poses[:, 0] + cos * x - sin * y, poses[:, 1] + sin * x + cos * y, z], axis=1)


def at_constant_speed(xyz: Array, stamps_ns: ArrayLike, trajectory: Trajectory) -> Array:
    """
    Return the points as they would lie had the vehicle driven straight at its mean speed.

    This is the facade before alignment, as the paper shows it (figures 12 and 13), made from the
    finished cloud alone: p_before = T_mean(t) T(t)^-1 p.

    Parameters
    ----------
    xyz
        (n, 3) points in odom, metres.
    stamps_ns
        (n,) times of their rays, nanoseconds.
    trajectory
        The poses the points were placed with.

    Returns
    -------
    Array
        (n, 3); NaN where the trajectory has no pose.

    """
    planar = np.column_stack([xyz[:, :2], np.zeros(len(xyz))])
    base = geometry.compose(geometry.inverse(trajectory.at(stamps_ns)), planar)
    moved = geometry.compose(constant_speed(trajectory).at(stamps_ns), base)
    return np.column_stack([moved[:, :2], xyz[:, 2] + 0.0 * moved[:, 0]])
