# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of an estimated motion against a true one, each with its unit.

Estimated and true poses are both of base_link.  Their frames differ by an unknown motion, so a
figure either needs no common frame or says how the two were laid on each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stri_mapping import geometry
from stri_mapping.errors import TrajectoryError
from stri_mapping.trajectory import Trajectory

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

# Longest time between two true poses that is bridged, seconds.
MAX_TRUTH_GAP = 1.0
# True speed from which a relative speed error means something, and up to which one stands.
MOVING, STANDING = 1.0, 0.02
# Relations no farther apart than this are the local ones, seconds.
LOCAL = 30.0


@dataclass(frozen=True)
class Metric:
    """One figure: its name in files, its value (None where the drive has no case of it)."""

    name: str
    value: float | None
    unit: str
    text: str


def _metric(name: str, value: float, unit: str, text: str) -> Metric:
    return Metric(name, float(value) if np.isfinite(value) else None, unit, text)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values ** 2))) if len(values) else np.nan


def _largest(values: Array) -> float:
    return float(np.max(np.abs(values))) if len(values) else np.nan


def common_poses(estimate: Trajectory, truth: Trajectory) -> tuple[Stamps, Array, Array]:
    """
    Return the estimate's stamps that the truth covers, and both poses there.

    Returns
    -------
    stamps_ns : Stamps
        (n,) nanoseconds.
    estimated, true : Array
        (n, 3) poses; the true ones interpolated over at most `MAX_TRUTH_GAP`.

    Raises
    ------
    TrajectoryError
        If fewer than two stamps are covered.

    """
    true = truth.at(estimate.stamps_ns, MAX_TRUTH_GAP)
    known = ~np.isnan(true[:, 0])
    if np.count_nonzero(known) < 2:
        raise TrajectoryError('truth and estimate have no time in common: '
                              f'{_span(truth)} against {_span(estimate)}')
    return estimate.stamps_ns[known], estimate.poses[known], true[known]


def _span(trajectory: Trajectory) -> str:
    if len(trajectory) == 0:
        return 'no pose'
    return f'{trajectory.stamps_ns[0] * 1e-9:.3f} to {trajectory.stamps_ns[-1] * 1e-9:.3f} s'


def align_start(estimated: Array, true: Array) -> Array:
    """Return the estimated poses (n, 3) moved as one so that the first is the true one."""
    return geometry.compose(geometry.compose(true[0], geometry.inverse(estimated[0])), estimated)


def align_best(estimated: Array, true: Array) -> Array:
    """
    Return the estimated poses (n, 3) moved as one so that positions fit best.

    Least squares over SE(2) without scale: Umeyama 1991, eq. 40 to 42, in the plane, where the
    rotation is the direction of the sum of products.
    """
    mean_est, mean_true = estimated[:, :2].mean(axis=0), true[:, :2].mean(axis=0)
    a = (estimated[:, :2] - mean_est) @ [1.0, 1.0j]
    b = (true[:, :2] - mean_true) @ [1.0, 1.0j]
    yaw = float(np.angle(np.vdot(a, b)))
    pivot_est, pivot_true = np.array([*mean_est, 0.0]), np.array([*mean_true, yaw])
    move = geometry.compose(pivot_true, geometry.inverse(pivot_est))
    return geometry.compose(move, estimated)


def path_metrics(estimate: Trajectory, truth: Trajectory) -> list[Metric]:
    """
    Return drift, absolute trajectory errors and heading errors.

    Raises
    ------
    TrajectoryError
        If truth and estimate have no time in common.

    """
    stamps, estimated, true = common_poses(estimate, truth)
    distance = Trajectory(stamps, true).distance
    started, fitted = align_start(estimated, true), align_best(estimated, true)
    error = np.hypot(*(started - true)[:, :2].T)
    heading = np.rad2deg(geometry.wrap_angle((started - true)[:, 2]))
    return [
        _metric('distance_m', distance, 'm', 'true distance driven'),
        _metric('end_error_m', error[-1], 'm', 'position error at the end, aligned at the start'),
        _metric('drift_percent', 100.0 * error[-1] / distance if distance > 0.0 else np.nan, '%',
                'that in percent of the distance'),
        _metric('ate_start_rmse_m', _rms(error), 'm', 'position error, aligned at the start, rms'),
        _metric('ate_start_max_m', _largest(error), 'm', 'the same, largest'),
        _metric('ate_fit_rmse_m', _rms(np.hypot(*(fitted - true)[:, :2].T)), 'm',
                'position error after the best fit in the plane, rms'),
        _metric('heading_rmse_deg', _rms(heading), 'deg', 'heading error, rms'),
        _metric('heading_end_deg', heading[-1], 'deg', 'heading error at the end')]


def displacements(trajectory: Trajectory, stamps_ns: Stamps, window: float,
                  point: ArrayLike = (0.0, 0.0)) -> Array:
    """
    Return how far a point of the vehicle moves in a window of time, as the vehicle sees it.

    Parameters
    ----------
    trajectory
        Poses of base_link.
    stamps_ns
        (n,) beginnings of the windows.
    window
        Seconds.
    point
        (2,) the point in base_link, metres.

    Returns
    -------
    Array
        (n, 2) metres, in base_link as it is turned at the beginning; NaN where the trajectory
        does not cover the window.

    """
    mount = np.array([*np.asarray(point, dtype=float), 0.0])
    before = trajectory.at(stamps_ns, MAX_TRUTH_GAP)
    after = trajectory.at(stamps_ns + round(window * 1e9), MAX_TRUTH_GAP)
    step = geometry.compose(geometry.inverse(before), geometry.compose(after, mount))
    return np.asarray((step - mount)[:, :2])


def speed_metrics(estimate: Trajectory, truth: Trajectory, window: float = 0.2,
                  point: ArrayLike = (0.0, 0.0)) -> list[Metric]:
    """
    Return velocity errors from displacements over a sliding window.

    Parameters
    ----------
    estimate, truth
        Poses of base_link; a window begins at every estimated pose.
    window
        Seconds.
    point
        (2,) point of the vehicle whose speed is judged, in base_link: a scanner off the middle
        moves otherwise than base_link in a turn.

    """
    estimated = displacements(estimate, estimate.stamps_ns, window, point) / window
    true = displacements(truth, estimate.stamps_ns, window, point) / window
    known = np.isfinite(estimated[:, 0]) & np.isfinite(true[:, 0])
    speed, true_speed = np.hypot(*estimated[known].T), np.hypot(*true[known].T)
    moving, standing = true_speed > MOVING, true_speed < STANDING
    relative = 100.0 * (speed[moving] / true_speed[moving] - 1.0)
    over = f'over {window:g} s'
    return [
        _metric('velocity_rmse_mps', _rms(np.hypot(*(estimated - true)[known].T)), 'm/s',
                f'velocity error {over}, both components, rms'),
        _metric('speed_error_rms_percent', _rms(relative), '%',
                f'relative speed error {over} above {MOVING:g} m/s, rms'),
        _metric('speed_error_worst_percent', _largest(relative), '%', 'the same, worst'),
        _metric('standing_speed_rms_mps', _rms(speed[standing]), 'm/s',
                'estimated speed while standing still, rms'),
        _metric('standing_speed_max_mps', _largest(speed[standing]), 'm/s', 'the same, largest')]


def twist_metrics(stamps_ns: Stamps, values: Array, truth: Trajectory,
                  window: float = 0.2) -> list[Metric]:
    """
    Return errors of the estimated twists and how honest their standard deviations are.

    Parameters
    ----------
    stamps_ns
        (n,) nanoseconds.
    values
        (n, 6 or more) vx, vy, wz of base_link and their standard deviations.
    truth
        Poses of base_link; their mean twist over a window around each stamp is the true one.
    window
        Seconds.

    """
    half = round(0.5e9 * window)
    step = geometry.compose(geometry.inverse(truth.at(stamps_ns - half, MAX_TRUTH_GAP)),
                            truth.at(stamps_ns + half, MAX_TRUTH_GAP))
    error = values[:, :3] - geometry.log(step) / window
    known = np.isfinite(error[:, 0])
    error, sigma = error[known], values[known, 3:6]
    share = 100.0 * np.mean(np.abs(error) <= 2.0 * sigma, axis=0) if len(error) else np.full(
        3, np.nan)
    return [
        _metric('twist_rmse_mps', _rms(np.hypot(error[:, 0], error[:, 1])), 'm/s',
                'velocity.csv: vx and vy of base_link, rms'),
        _metric('twist_rmse_degps', _rms(np.rad2deg(error[:, 2])), 'deg/s',
                'velocity.csv: wz, rms'),
        *(_metric(f'within_2_sigma_{name}_percent', value, '%',
                  f'velocity.csv: {name} within two standard deviations (95 is honest)')
          for name, value in zip(('vx', 'vy', 'wz'), share))]


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
        raise TrajectoryError(f'the estimate ({_span(estimate)}) covers none of the '
                              f'{len(relations.poses)} relations')
    local = covered & (np.abs(relations.second_ns - relations.first_ns) < LOCAL * 1e9)
    metrics = []
    for name, which, words in (('local', local, f'relations under {LOCAL:g} s apart'),
                               ('all', covered, 'all relations')):
        t, r = translation[which], np.rad2deg(rotation[which])
        metrics += [
            _metric(f'relations_{name}', len(t), '', f'{words}: number covered'),
            _metric(f'relations_{name}_mean_m', t.mean() if len(t) else np.nan, 'm',
                    f'{words}: mean translational error'),
            _metric(f'relations_{name}_mean_deg', r.mean() if len(r) else np.nan, 'deg',
                    f'{words}: mean rotational error')]
    return metrics
