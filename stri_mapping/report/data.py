# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the report is made of, read from a results folder; missing parts are None."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any
import zipfile

import numpy as np
from numpy.typing import NDArray

from stri_mapping import geometry
from stri_mapping.errors import StriMappingError
from stri_mapping.facade.cloud_files import count_points, PLY_NAME, read_ply
from stri_mapping.facade.placing import at_constant_speed
from stri_mapping.motion_file import read_velocity
from stri_mapping.results import EVALUATION_NAME, RANGE_IMAGE_NAME, TRAJECTORY_NAME, VELOCITY_NAME
from stri_mapping.summary import read_summary
from stri_mapping.trajectory import read_tum, Trajectory

Array = NDArray[np.float64]

# Points drawn at most: a denser cloud is thinned evenly in time.
MAX_POINTS = 2_000_000
# A drive whose ends are nearer than this share of its length is not straight enough to be
# compared with a straight drive at constant speed.
STRAIGHT = 0.7
# Height above the lowest points in which a point may belong to the ground, metres.
GROUND = 0.5


@dataclass(frozen=True, eq=False)
class RangeImageData:
    """The thinned range image of the drive: see `stri.range_image.RangeImageLog.save`."""

    seconds: Array
    bearings: Array
    ranges: NDArray[np.float32]
    segments: NDArray[np.int32]

    def points(self, path: Trajectory, T_base_laser: Array) -> Array:
        """Return its returns as points (n, 2) in odom, each scan placed by its stamp's pose."""
        stamps = path.stamps_ns[0] + np.rint(1e9 * self.seconds).astype(np.int64)
        row, column = np.nonzero(np.isfinite(self.ranges))
        poses, reach = path.at(stamps)[row], self.ranges[row, column].astype(float)
        rays = np.stack([np.cos(self.bearings), np.sin(self.bearings)], axis=1)[column]
        base = (reach[:, None] * rays) @ T_base_laser[:2, :2].T + T_base_laser[:2, 3]
        placed = geometry.compose(poses, np.column_stack([base, np.zeros(len(base))]))[:, :2]
        return placed[np.isfinite(placed[:, 0])]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points (n, 3) as aligned, and as they would lie at constant speed (None if not straight)."""

    xyz: Array
    intensity: Array
    before: Array | None


@dataclass(frozen=True, eq=False)
class ReportData:
    """Everything in the folder; times in seconds since the first pose."""

    summary: dict[str, Any]
    evaluation: dict[str, Any]
    path: Trajectory | None
    seconds: Array
    velocity: Array
    range_image: RangeImageData | None
    cloud: Cloud | None

    @property
    def degenerate(self) -> list[tuple[float, float]]:
        """Stretches (from, to) in seconds in which the motion was not observable."""
        if self.path is None:
            return []
        origin = self.path.stamps_ns[0] * 1e-9
        return [(a - origin, b - origin) for a, b in self.summary.get('degenerate_stretches', [])]

    @property
    def walls(self) -> Array | None:
        """Points (n, 2) in odom of what stands beside the path; None where nothing is known."""
        if self.cloud is not None:
            z = self.cloud.xyz[:, 2]
            return self.cloud.xyz[z > np.percentile(z, 0.3) + GROUND, :2]
        scanners = self.summary.get('scanners', [])
        mounts = [s['mount'] for s in scanners if s['role'] == 'horizontal']
        if self.path is None or self.range_image is None or not mounts:
            return None
        return self.range_image.points(self.path, geometry.transform(**mounts[0]))


def read_folder(folder: Path) -> ReportData:
    """
    Read a results folder.

    Raises
    ------
    StriMappingError
        If a file that is there cannot be understood.

    """
    path = read_tum(folder / TRAJECTORY_NAME) if (folder / TRAJECTORY_NAME).is_file() else None
    path = path if path is not None and len(path) > 1 else None
    stamps, velocity = np.empty(0, np.int64), np.empty((0, 7))
    if (folder / VELOCITY_NAME).is_file():
        stamps, velocity = read_velocity(folder / VELOCITY_NAME)
    origin = int(path.stamps_ns[0]) if path is not None else 0
    seconds = 1e-9 * (stamps - origin).astype(float)
    return ReportData(
        read_summary(folder), _evaluation(folder / EVALUATION_NAME), path, seconds, velocity,
        _range_image(folder / RANGE_IMAGE_NAME, origin), _cloud(folder / PLY_NAME, path))


def _evaluation(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        return dict(json.loads(path.read_text(encoding='utf-8')))
    except ValueError:
        raise StriMappingError(f'{path}: want a JSON object') from None


def _range_image(path: Path, origin: int) -> RangeImageData | None:
    if not path.is_file():
        return None
    try:
        with np.load(path) as content:
            if len(content['stamps_ns']) < 2 or len(content['bearings']) < 2:
                return None
            return RangeImageData((content['stamps_ns'] - origin) * 1e-9, content['bearings'],
                                  content['ranges'], content['segments'])
    except (KeyError, ValueError, OSError, zipfile.BadZipFile):
        raise StriMappingError(f'{path}: want the arrays stamps_ns, bearings, ranges and '
                               'segments') from None


def _cloud(path: Path, trajectory: Trajectory | None) -> Cloud | None:
    count = count_points(path)
    if count == 0 or trajectory is None:
        return None
    rows = np.concatenate(list(read_ply(path, every=-(-count // MAX_POINTS))))
    xyz = np.column_stack([rows['x'], rows['y'], rows['z']])
    chord = float(np.hypot(*(trajectory.poses[-1] - trajectory.poses[0])[:2]))
    before = None
    if chord > STRAIGHT * trajectory.distance > 0.0:
        # a time as a float of seconds is good to 0.2 microseconds: no ray falls off the ends
        stamps = np.clip(np.rint(rows['time'] * 1e9).astype(np.int64),
                         trajectory.stamps_ns[0], trajectory.stamps_ns[-1])
        before = at_constant_speed(xyz, stamps, trajectory)
    return Cloud(xyz, rows['intensity'].astype(float), before)
