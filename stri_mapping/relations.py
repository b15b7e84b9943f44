# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors against relative poses between pairs of scans.

This is the truth of the SLAM benchmark of Kuemmerle et al. 2009, "On measuring the accuracy of
SLAM algorithms": recordings without a true path have true relations, checked by hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stri_mapping import geometry
from stri_mapping.errors import TrajectoryError
from stri_mapping.metrics import MAX_TRUTH_GAP, Metric, metric, span_of
from stri_mapping.trajectory import Trajectory

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

# Relations no farther apart than this are the local ones, seconds.
LOCAL = 30.0


@dataclass(frozen=True, eq=False)
class Relations:
    """
    Relative poses of the laser between pairs of scans, the truth of the SLAM benchmark.

    Attributes
    ----------
    first_ns, second_ns
        (n,) stamps of the scans.
    poses
        (n, 3) pose of the laser at the second stamp seen from that at the first.

    """

    first_ns: Stamps
    second_ns: Stamps
    poses: Array


def read_relations(path: Path) -> Relations:
    """
    Read a table with the columns t1,t2,dx,dy,dyaw: seconds, seconds, metres, metres, radians.

    Raises
    ------
    TrajectoryError
        If the file is missing or a line does not hold five numbers.

    """
    try:
        header, *lines = path.read_text(encoding='utf-8').splitlines() or ['']
    except OSError as error:
        raise TrajectoryError(f'{path}: {error.strerror}') from None
    if header.replace(' ', '') != 't1,t2,dx,dy,dyaw':
        raise TrajectoryError(f'{path}:1: want the header "t1,t2,dx,dy,dyaw", '
                              f'got "{header[:60]}"')
    stamps, poses = [], []
    for number, line in enumerate(lines, start=2):
        try:
            first, second, *pose = line.split(',')
            stamps.append([_nanoseconds(first), _nanoseconds(second)])
            poses.append([float(v) for v in pose])
            if len(pose) != 3 or not np.all(np.isfinite(poses[-1])):
                raise ValueError
        except ValueError:
            raise TrajectoryError(f'{path}:{number}: want "t1,t2,dx,dy,dyaw", '
                                  f'got "{line[:60]}"') from None
    pairs = np.array(stamps, dtype=np.int64).reshape(-1, 2)
    return Relations(pairs[:, 0], pairs[:, 1], np.array(poses).reshape(-1, 3))


def _nanoseconds(seconds: str) -> int:
    whole, _, decimals = seconds.strip().partition('.')
    return int(whole) * 10**9 + int(f'{decimals:0<9}'[:9])


def relation_errors(
    estimate: Trajectory, relations: Relations, mount: ArrayLike,
) -> tuple[Array, Array]:
    """
    Return the error of every relation: the estimate's relative pose minus the true one.

    Parameters
    ----------
    estimate
        Poses of base_link.
    relations
        Relative poses of the laser.
    mount
        (3,) pose (x, y, yaw) of the laser in base_link.

    Returns
    -------
    translation, rotation : Array
        (n,) metres and radians, not negative; NaN where the estimate lacks one of the stamps.

    """
    laser = [geometry.compose(_at_scans(estimate, stamps), mount)
             for stamps in (relations.first_ns, relations.second_ns)]
    relative = geometry.compose(geometry.inverse(laser[0]), laser[1])
    error = geometry.compose(geometry.inverse(relations.poses), relative)
    return np.hypot(error[:, 0], error[:, 1]), np.abs(geometry.wrap_angle(error[:, 2]))


def _at_scans(trajectory: Trajectory, stamps_ns: Stamps) -> Array:
    """Return poses at stamps that a table rounded to microseconds, the ends' too."""
    if len(trajectory) == 0:
        return np.full((len(stamps_ns), 3), np.nan)
    inside = np.clip(stamps_ns, trajectory.stamps_ns[0], trajectory.stamps_ns[-1])
    poses = trajectory.at(inside, MAX_TRUTH_GAP)
    poses[np.abs(inside - stamps_ns) > 1_000_000] = np.nan
    return poses


def relation_metrics(
    estimate: Trajectory, relations: Relations, mount: ArrayLike,
) -> list[Metric]:
    """
    Return mean errors of the local relations (under `LOCAL` seconds apart) and of all.

    Raises
    ------
    TrajectoryError
        If the estimate covers none of them.

    """
    translation, rotation = relation_errors(estimate, relations, mount)
    covered = np.isfinite(translation)
    if not np.any(covered):
        raise TrajectoryError(f'the estimate ({span_of(estimate)}) covers none of the '
                              f'{len(relations.poses)} relations')
    local = covered & (np.abs(relations.second_ns - relations.first_ns) < LOCAL * 1e9)
    metrics = []
    for name, which, words in (('local', local, f'relations under {LOCAL:g} s apart'),
                               ('all', covered, 'all relations')):
        t, r = translation[which], np.rad2deg(rotation[which])
        metrics += [
            metric(f'relations_{name}', len(t), '', f'{words}: number covered'),
            metric(f'relations_{name}_mean_m', t.mean() if len(t) else np.nan, 'm',
                    f'{words}: mean translational error'),
            metric(f'relations_{name}_mean_deg', r.mean() if len(r) else np.nan, 'deg',
                    f'{words}: mean rotational error')]
    return metrics
