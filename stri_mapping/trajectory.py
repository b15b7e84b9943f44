# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Stamped planar poses: interpolation at ray times and the TUM text format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stri_mapping import geometry
from stri_mapping.errors import TrajectoryError

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    Poses of base_link in odom over time.

    Attributes
    ----------
    stamps_ns
        (n,) int64 nanoseconds, strictly increasing.
    poses
        (n, 3) as (x, y, yaw) in metres and radians; yaw continuous, not wrapped.

    Raises
    ------
    TrajectoryError
        If the lengths differ or the stamps do not increase.

    """

    stamps_ns: Stamps
    poses: Array

    def __post_init__(self) -> None:
        """Check shapes and the order of the stamps."""
        if self.poses.shape != (len(self.stamps_ns), 3):
            raise TrajectoryError(f'{len(self.stamps_ns)} stamps with poses of shape '
                                  f'{self.poses.shape}, want (n, 3)')
        if np.any(np.diff(self.stamps_ns) <= 0):
            raise TrajectoryError('stamps of a trajectory must increase')

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.stamps_ns)

    def at(self, stamps_ns: ArrayLike, max_gap: float = np.inf) -> Array:
        """
        Return the poses at given times.

        Between two poses the body twist is constant (interpolation along the SE(2) geodesic).

        Parameters
        ----------
        stamps_ns
            (m,) nanoseconds; any order.
        max_gap
            Longest time between two poses, in seconds, that is bridged.

        Returns
        -------
        Array
            (m, 3) poses; NaN outside the span of the trajectory and inside longer gaps than
            `max_gap`, where nothing is known.

        """
        t = np.atleast_1d(np.asarray(stamps_ns, dtype=np.int64))
        if len(self) < 2 or len(t) == 0:
            out = np.full((len(t), 3), np.nan)
            out[np.isin(t, self.stamps_ns)] = self.poses[:1]
            return out
        k = np.clip(np.searchsorted(self.stamps_ns, t, side='right') - 1, 0, len(self) - 2)
        start, stop = self.stamps_ns[k], self.stamps_ns[k + 1]
        # one step for every pair of poses, not for every ray: rays are many times more
        first = k.min()
        poses = self.poses[first:k.max() + 2]
        step = geometry.log(geometry.compose(geometry.inverse(poses[:-1]), poses[1:]))
        fraction = (t - start) / (stop - start)
        k -= first
        out = geometry.compose(poses[k], geometry.exp(fraction[:, None] * step[k]))
        known = (start <= t) & (t <= stop) & (
            (stop - start <= max_gap * 1e9) | (t == start) | (t == stop))
        out[~known] = np.nan
        return out

    @property
    def distance(self) -> float:
        """Length of the path in metres."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())

    @property
    def duration(self) -> float:
        """Seconds from the first pose to the last; 0 for fewer than two."""
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9 if len(self) else 0.0


def constant_speed(trajectory: Trajectory) -> Trajectory:
    """
    Return the straight drive at constant mean speed over the same stamps.

    This is what one has without an estimate of the motion, and what the paper shows for
    comparison (figures 12 and 13).  It starts at the first pose and ends at the last one's
    distance, along the chord.
    """
    if len(trajectory) < 2:
        return trajectory
    t = (trajectory.stamps_ns - trajectory.stamps_ns[0]) / (
        trajectory.stamps_ns[-1] - trajectory.stamps_ns[0])
    first, last = trajectory.poses[0], trajectory.poses[-1]
    poses = np.empty_like(trajectory.poses)
    poses[:, :2] = first[:2] + t[:, None] * (last[:2] - first[:2])
    poses[:, 2] = np.arctan2(last[1] - first[1], last[0] - first[0])
    return Trajectory(trajectory.stamps_ns, poses)


def stamp_text(stamp_ns: int) -> str:
    """Return a stamp as seconds with 9 decimals, exact."""
    return f'{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}'


def stamp_of(text: str) -> int:
    """Return nanoseconds from seconds with up to 9 decimals, exact; raises ValueError."""
    seconds, _, decimals = text.partition('.')
    return int(seconds) * 10**9 + int(f'{decimals:0<9}'[:9])


def tum_line(stamp_ns: int, pose: ArrayLike) -> str:
    """Return one TUM line, ``stamp x y z qx qy qz qw``, all with 9 decimals, stamp exact."""
    x, y, yaw = np.asarray(pose, dtype=float)
    values = (x, y, 0.0, *geometry.quat_from_yaw(float(yaw)))
    return ' '.join([stamp_text(stamp_ns), *(f'{v:.9f}' for v in values)])


def spatial_tum_line(stamp_ns: int, pose: ArrayLike) -> str:
    """Return one TUM line, as `tum_line`, of a pose (6,): x, y, z, roll, pitch, yaw."""
    values = np.asarray(pose, dtype=float)
    quat = geometry.quat_from_rpy(values[3:])
    return ' '.join([stamp_text(stamp_ns), *(f'{v:.9f}' for v in (*values[:3], *quat))])


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory as TUM text; the same result as `tum_line` for every pose."""
    lines = [tum_line(int(s), p) for s, p in zip(trajectory.stamps_ns, trajectory.poses)]
    path.write_text(''.join(line + '\n' for line in lines), encoding='utf-8')


def read_tum(path: Path) -> Trajectory:
    """
    Read TUM text; lines starting with # are skipped, height, roll and pitch are dropped.

    Raises
    ------
    TrajectoryError
        If the file is missing or a line does not hold eight finite numbers.

    """
    stamps, values = _read_lines(path)
    yaw = np.unwrap(geometry.yaw_from_quat(values[:, 3:]))
    return Trajectory(stamps, np.column_stack([values[:, :2], yaw]))


def read_spatial_tum(path: Path) -> tuple[Stamps, Array]:
    """
    Read TUM text as stamps (n,) and poses (n, 6): x, y, z, roll, pitch, yaw (continuous).

    Raises
    ------
    TrajectoryError
        As `read_tum`.

    """
    stamps, values = _read_lines(path)
    rpy = np.array([geometry.rpy_from_rotation(geometry.rotation_from_quat(q))
                    for q in values[:, 3:]]).reshape(-1, 3)
    rpy[:, 2] = np.unwrap(rpy[:, 2])
    return stamps, np.column_stack([values[:, :3], rpy])


def _read_lines(path: Path) -> tuple[Stamps, Array]:
    """Return stamps (n,) and the numbers after them (n, 7) of a TUM file."""
    try:
        lines = path.read_text(encoding='utf-8').splitlines()
    except OSError as error:
        raise TrajectoryError(f'{path}: {error.strerror}') from None
    stamps, rows = [], []
    for number, line in enumerate(lines, start=1):
        fields = line.split()
        if not fields or fields[0].startswith('#'):
            continue
        try:
            stamps.append(stamp_of(fields[0]))
            rows.append([float(v) for v in fields[1:]])
            if len(rows[-1]) != 7 or not np.all(np.isfinite(rows[-1])):
                raise ValueError
        except ValueError:
            raise TrajectoryError(f'{path}:{number}: want "stamp x y z qx qy qz qw", '
                                  f'got "{line[:60]}"') from None
    return np.array(stamps, dtype=np.int64), np.array(rows).reshape(-1, 7)
