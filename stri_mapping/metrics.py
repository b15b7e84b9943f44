# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of an estimated motion against a true one, each with its unit.

Estimated and true poses are both of base_link.  Their frames differ by an unknown motion, so a
figure either needs no common frame or says how the two were laid on each other.
"""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class Metric:
    """One figure: its name in files, its value (None where the drive has no case of it)."""

    name: str
    value: float | None
    unit: str
    text: str


def metric(name: str, value: float, unit: str, text: str) -> Metric:
    """Return a metric; NaN means that there is no case of it."""
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
                              f'{span_of(truth)} against {span_of(estimate)}')
    return estimate.stamps_ns[known], estimate.poses[known], true[known]


def span_of(trajectory: Trajectory) -> str:
    """Return in words, for messages, which time a trajectory covers."""
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
        metric('distance_m', distance, 'm', 'true distance driven'),
        metric('end_error_m', error[-1], 'm', 'position error at the end, aligned at the start'),
        metric('drift_percent', 100.0 * error[-1] / distance if distance > 0.0 else np.nan, '%',
                'that in percent of the distance'),
        metric('ate_start_rmse_m', _rms(error), 'm', 'position error, aligned at the start, rms'),
        metric('ate_start_max_m', _largest(error), 'm', 'the same, largest'),
        metric('ate_fit_rmse_m', _rms(np.hypot(*(fitted - true)[:, :2].T)), 'm',
                'position error after the best fit in the plane, rms'),
        metric('heading_rmse_deg', _rms(heading), 'deg', 'heading error, rms'),
        metric('heading_end_deg', heading[-1], 'deg', 'heading error at the end')]


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
        metric('velocity_rmse_mps', _rms(np.hypot(*(estimated - true)[known].T)), 'm/s',
                f'velocity error {over}, both components, rms'),
        metric('speed_error_rms_percent', _rms(relative), '%',
                f'relative speed error {over} above {MOVING:g} m/s, rms'),
        metric('speed_error_worst_percent', _largest(relative), '%', 'the same, worst'),
        metric('standing_speed_rms_mps', _rms(speed[standing]), 'm/s',
                'estimated speed while standing still, rms'),
        metric('standing_speed_max_mps', _largest(speed[standing]), 'm/s', 'the same, largest')]


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
        metric('twist_rmse_mps', _rms(np.hypot(error[:, 0], error[:, 1])), 'm/s',
                'velocity.csv: vx and vy of base_link, rms'),
        metric('twist_rmse_degps', _rms(np.rad2deg(error[:, 2])), 'deg/s',
                'velocity.csv: wz, rms'),
        *(metric(f'within_2_sigma_{name}_percent', value, '%',
                  f'velocity.csv: {name} within two standard deviations (95 is honest)')
          for name, value in zip(('vx', 'vy', 'wz'), share))]
