# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors and cost of the estimator over scenes and seeds of the virtual vehicle, as a table.

Judged at the horizontal scanner in the plane, its true path from the full six degrees of
freedom: pitch moves a scanner 1.2 m up against base_link, and that is motion it rightly sees.

    python benchmarks/estimator.py street corner --seeds 1 2 3
    python benchmarks/estimator.py street corner --pull 4e-5
    python benchmarks/estimator.py street --seeds 1 --remission
    python benchmarks/estimator.py campus street --seeds 1 --ablate
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
import gc
import itertools
import time

import numpy as np
from numpy.typing import NDArray

from stri_mapping import geometry
from stri_mapping.metrics import path_metrics, speed_metrics
from stri_mapping.scan import Scan
from stri_mapping.simulation.beam import ECHOES
from stri_mapping.simulation.drive import Drive, make_drive, START_NS
from stri_mapping.simulation.scenes import Options
from stri_mapping.stri.config import EstimatorConfig, JointConfig
from stri_mapping.stri.estimate import Estimate
from stri_mapping.stri.estimator import StriEstimator
from stri_mapping.trajectory import Trajectory
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, Vehicle

Array = NDArray[np.float64]
VEHICLE = load_vehicle(default_vehicle_file())
SCENES = ('campus', 'street', 'corner', 'reverse', 'stops', 'bare_wall')
COLUMNS = ('drift_percent', 'heading_end_deg', 'velocity_rmse_mps', 'speed_error_worst_percent',
           'standing_speed_max_mps')


def scanner_truth(drive: Drive) -> Trajectory:
    """Return the true path of the horizontal scanner in the plane."""
    t = drive.truth_times()
    poses = drive.scene.motion.at(t)
    mount = drive.vehicle.horizontal.T_base_laser
    T = np.array([geometry.transform(p[:3], p[3:]) @ mount for p in poses])
    yaw = np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
    stamps = START_NS + np.round(1e9 * t).astype(np.int64)
    return Trajectory(stamps, np.column_stack([T[:, :2, 3], yaw]))


def estimate(scans: list[Scan], mount: Array, config: EstimatorConfig) -> tuple[
        list[Estimate], list[float]]:
    """Return the final estimates, and the seconds each scan took."""
    estimator = StriEstimator(mount, config)
    gc.freeze()             # as the node does
    taken, final = [], []
    for scan in scans:
        began = time.perf_counter()
        estimator.add(scan)
        final += estimator.take_refined()
        taken.append(time.perf_counter() - began)
    estimator.finish()
    return final + estimator.take_refined(), taken


def scanner_path(final: list[Estimate], mount: Array) -> Trajectory:
    """Return the scanner's path."""
    stamps = np.array([e.stamp_ns for e in final], dtype=np.int64)
    poses = geometry.compose(np.array([e.pose for e in final]), geometry.planar_pose(mount))
    return Trajectory(stamps, poses)


def make(
    scene: str, seed: int, remission: bool = False, echo: str = 'pulse',
) -> tuple[list[Scan], Trajectory]:
    """Return the horizontal scans of a drive, by a scanner of some kind, and the true path."""
    drive = make_drive(scene, Options(seed), vehicle=Vehicle((VEHICLE.horizontal,)))
    drive.scanners[0].remission = remission
    drive.scanners[0].model = replace(drive.scanners[0].model, echo=echo)
    return [timed.scan for timed in drive.scans()], scanner_truth(drive)


def polynomial(path: Trajectory) -> Trajectory:
    """Return a path forced through one polynomial of 6th degree, as the paper draws it."""
    t = (path.stamps_ns - path.stamps_ns[0]) / np.ptp(path.stamps_ns)
    powers = np.polynomial.polynomial.polyfit(t, path.poses, 6)
    return Trajectory(path.stamps_ns, np.polynomial.polynomial.polyval(t, powers).T)


def run(
    scans: list[Scan], truth: Trajectory, config: EstimatorConfig,
    shape: Callable[[Trajectory], Trajectory] = lambda path: path,
) -> tuple[dict[str, float], list[float]]:
    """Return the figures of one drive by name, and the seconds of every scan."""
    mount = VEHICLE.horizontal.T_base_laser
    final, taken = estimate(scans, mount, config)
    path = shape(scanner_path(final, mount))
    blind = float(np.diff(path.stamps_ns)[[e.degenerate for e in final[1:]]].sum()) * 1e-9
    metrics = {m.name: m.value for m in (*path_metrics(path, truth), *speed_metrics(path, truth))}
    figures = {name: np.nan if metrics[name] is None else float(metrics[name] or 0.0)
               for name in COLUMNS}
    return {**figures, 'blind_s': blind}, taken


def ablate(scene: str, seed: int) -> None:
    """Print a row for the estimator without each of its parts."""
    scans, truth = make(scene, seed)
    full = EstimatorConfig()
    pairwise = JointConfig(active=4, lags=(1,), distances=())
    frozen = [replace(scan, times=np.zeros(len(scan))) for scan in scans]
    forms = {
        'pairwise only': run(scans, truth, EstimatorConfig(joint=pairwise)),
        'no segmentation': run(
            scans, truth, EstimatorConfig(joint=JointConfig(judge_surfaces=False))),
        'no per-ray time': run(frozen, truth, full),
        'footprint not learnt': run(
            scans, truth, EstimatorConfig(joint=JointConfig(learn_error=False))),
        'single polynomial': run(scans, truth, full, polynomial),
        'full': run(scans, truth, full),
    }
    for name, (figures, taken) in forms.items():
        row(f'{scene} {seed}, {name}', figures, taken)


def row(name: str, figures: dict[str, float], taken: list[float]) -> None:
    """Print one row of the table."""
    values = ' | '.join('-' if np.isnan(v) else f'{v:.3g}' for v in figures.values())
    print(f'| {name} | {values} | {1e3 * np.mean(taken):.2f} ({1e3 * max(taken):.0f}) |',
          flush=True)


def main() -> None:
    """Print one row a drive, and the distribution."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('scenes', nargs='*', default=list(SCENES))
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2])
    parser.add_argument('--no-range-error', action='store_true',
                        help='do not learn the pull of slanted footprints')
    parser.add_argument('--pull', type=float,
                        help='of slanted footprints, 1/m, as an earlier drive has told it')
    parser.add_argument('--remission', action='store_true',
                        help='the scanner sends remission, whose edges are used')
    parser.add_argument('--echo', choices=ECHOES, default='pulse',
                        help='what the scanner makes of slanted footprints and edges')
    parser.add_argument('--ablate', action='store_true',
                        help='rows without each part of the estimator')
    args = parser.parse_args()
    config = EstimatorConfig(
        joint=JointConfig(learn_error=not args.no_range_error)).knowing(args.pull)
    StriEstimator(np.eye(4), config).warm_up()
    print('| drive | drift % | heading deg | velocity rmse m/s | worst speed % | standing m/s '
          '| not observable s | ms a scan, mean (longest) |\n|---|---|---|---|---|---|---|---|')
    drifts, speeds = [], []
    for scene, seed in itertools.product(args.scenes, args.seeds):
        if args.ablate:
            ablate(scene, seed)
            continue
        figures, taken = run(*make(scene, seed, args.remission, args.echo), config)
        speeds.append(figures['velocity_rmse_mps'])
        drifts.append(figures['drift_percent'])
        row(f'{scene} {seed}', figures, taken)
    if drifts:
        print(f'\ndrift of {len(drifts)} drives: median {np.median(drifts):.2f} %, '
              f'95th percentile {np.percentile(drifts, 95):.2f} %; '
              f'velocity rmse: median {np.median(speeds):.4f} m/s')


if __name__ == '__main__':
    main()
