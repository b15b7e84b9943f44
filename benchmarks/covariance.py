# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Whether the estimator's covariances tell its errors, over scenes and seeds, as a table.

    python benchmarks/covariance.py campus street --seeds 1 2 3
"""

from __future__ import annotations

import argparse
import itertools

from estimator import estimate, make, SCENES, VEHICLE
import numpy as np
from numpy.typing import NDArray

from stri_mapping import geometry
from stri_mapping.stri.config import EstimatorConfig
from stri_mapping.stri.estimate import Estimate
from stri_mapping.trajectory import Trajectory

Array = NDArray[np.float64]
SPAN_S, EVERY = 1.0, 15             # seconds of a displacement, scans from one to the next


def normalised_errors(final: list[Estimate], truth: Array) -> Array:
    """
    Return the squared errors of displacements over a second, over their expectation.

    The covariance of a displacement is what the pose's grows by in the moving frame, which
    leaves out what both ends have in common; NaN where it does not grow in all directions, since
    later scans have told the earlier pose.

    Parameters
    ----------
    final
        Final estimates, n.
    truth
        (n, 3) true poses of base_link.

    """
    times = np.array([e.stamp_ns - final[0].stamp_ns for e in final]) * 1e-9
    ends = np.searchsorted(times, times + SPAN_S)
    errors = []
    for i in np.flatnonzero(ends < len(final))[::EVERY]:
        a, b = final[i], final[ends[i]]
        moved = geometry.compose(geometry.inverse(a.pose), b.pose)
        true = geometry.compose(geometry.inverse(truth[i]), truth[ends[i]])
        error = geometry.compose(geometry.inverse(true), moved)
        along = np.eye(3)
        along[:2, 2] = a.pose[1] - b.pose[1], b.pose[0] - a.pose[0]
        growth = b.pose_covariance - along @ a.pose_covariance @ along.T
        turn = geometry.rotation_from_rpy(0.0, 0.0, b.pose[2])
        growth = turn.T @ growth @ turn
        grown = np.linalg.eigvalsh(growth)[0] > 0.0
        errors.append(error @ np.linalg.solve(growth, error) / 3.0 if grown else np.nan)
    return np.array(errors)


def farthest(final: list[Estimate], truth: Array) -> float:
    """Return the largest error of the position in standard deviations; the path begins at 0."""
    error = np.array([e.pose[:2] for e in final]) - truth[:, :2]
    sigmas = [np.sqrt(d @ np.linalg.solve(e.pose_covariance[:2, :2], d))
              for d, e in zip(error[1:], final[1:])]
    return float(max(sigmas))


def base_truth(truth: Trajectory, final: list[Estimate]) -> Array:
    """Return (n, 3) true poses of base_link, under the scanner, from where the path begins."""
    mount = geometry.planar_pose(VEHICLE.horizontal.T_base_laser)
    poses = geometry.compose(truth.at([e.stamp_ns for e in final]), geometry.inverse(mount))
    return geometry.compose(geometry.inverse(poses[0]), poses)


def main() -> None:
    """Print one row a drive, and the mean of all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('scenes', nargs='*', default=list(SCENES))
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2])
    args = parser.parse_args()
    print('| drive | mean | median | 95th percentile | left out % | farthest, sigma |\n'
          '|---|---|---|---|---|---|')
    means = []
    for scene, seed in itertools.product(args.scenes, args.seeds):
        scans, path = make(scene, seed)
        final, _ = estimate(scans, VEHICLE.horizontal.T_base_laser, EstimatorConfig())
        truth = base_truth(path, final)
        errors = normalised_errors(final, truth)
        told = errors[np.isfinite(errors)]
        means.append(told.mean())
        print(f'| {scene} {seed} | {means[-1]:.2f} | {np.median(told):.2f} '
              f'| {np.percentile(told, 95):.1f} | {100.0 - 100.0 * len(told) / len(errors):.0f} '
              f'| {farthest(final, truth):.1f} |', flush=True)
    print(f'\nmean of {len(means)} drives: {np.mean(means):.2f}')


if __name__ == '__main__':
    main()
