# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
How near facades come to the truth over several virtual drives.

    python benchmarks/facade.py [--seeds 1 2 3] [--duration 30] [--vibration 1.8]

Each drive is mapped twice, with the true planar path and with the estimator's.  Printed for
each: roll and pitch against the truth; the distance of facade points 0.5 to 15 m high from the
true surfaces in pieces of 20 m, each aligned rigidly, points further than 0.15 m off left out
(movers, and rays that hit two things); how far apart the scanners see a surface; and in brackets
the same with perfect poses and without stabilisation.  `campus` gives the columns' figures.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stri_mapping import geometry
from stri_mapping.facade.placing import place
from stri_mapping.facade.points import FACADE, FacadePoints, NOISE
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.facade.quality import measure
from stri_mapping.simulation.drive import Drive, make_drive, START_NS
from stri_mapping.simulation.nearest import Surfaces
from stri_mapping.simulation.scanner import TimedScan
from stri_mapping.simulation.scenes import Options
from stri_mapping.stri.estimator import StriEstimator
from stri_mapping.trajectory import Trajectory

Array = NDArray[np.float64]

PIECE, LOW, HIGH, TRIM, SAMPLE = 20.0, 0.5, 15.0, 0.15, 8000


class Mapped:
    """A drive's points with one path, stabilised or not, with the poses they were placed by."""

    def __init__(self, drive: Drive, scans: Sequence[TimedScan], path: Trajectory,
                 pivot: Array, stabilise: bool = True) -> None:
        """Align."""
        aligner = FacadeAligner(drive.vehicle.verticals, pivot, stabilise)
        rings = {s.name: ring for ring, s in enumerate(drive.vehicle.verticals)}
        for timed in scans:
            if timed.scanner.name in rings:
                aligner.add_scan(rings[timed.scanner.name], timed.scan)
        aligner.add_poses(path.stamps_ns, path.poses)
        aligner.finish()
        self.points = aligner.take_points()
        self.stamps, self.poses = aligner.take_poses()


def true_poses(drive: Drive, stamps: NDArray[np.int64]) -> Array:
    """Return x, y, z, roll, pitch, yaw (n, 6) of the truth."""
    return drive.scene.motion.at((stamps - START_NS) * 1e-9)


def estimated_path(drive: Drive, scans: Sequence[TimedScan]) -> Trajectory:
    """Return the estimator's path, moved as a whole onto the true first pose."""
    estimator = StriEstimator(drive.vehicle.horizontal.T_base_laser)
    refined = []
    for timed in scans:
        if timed.scanner.role == 'horizontal':
            estimator.add(timed.scan)
            refined += estimator.take_refined()
    estimator.finish()
    refined += estimator.take_refined()
    stamps = np.array([e.stamp_ns for e in refined], dtype=np.int64)
    first = true_poses(drive, stamps[:1])[:, [0, 1, 5]]
    return Trajectory(stamps, geometry.compose(first, np.array([e.pose for e in refined])))


def perfect(drive: Drive, points: FacadePoints, mapped: Mapped, pivot: Array) -> Array:
    """Return where points lie with perfect poses, from where a mapping put them."""
    base = in_base(mapped, points, pivot)
    true = true_poses(drive, points.stamps_ns)
    return place(base, true[:, [0, 1, 5]], true[:, [3, 4, 2]], np.zeros(3))


def in_base(mapped: Mapped, points: FacadePoints, pivot: Array) -> Array:
    """Return points of an unstabilised mapping in base_link."""
    path = Trajectory(mapped.stamps, mapped.poses[:, [0, 1, 5]])
    planar = np.column_stack([points.xyz[:, :2], np.zeros(len(points))])
    back = geometry.compose(geometry.inverse(path.at(points.stamps_ns)), planar)
    return np.column_stack([back[:, :2], points.xyz[:, 2]])


class Judge:
    """Measures clouds of one drive against its true surfaces."""

    def __init__(self, drive: Drive) -> None:
        """Prepare the surfaces."""
        self._drive = drive
        self._surfaces = Surfaces(drive.scene.mesh.triangles)

    def distance_mm(self, xyz: Array, stamps: NDArray[np.int64], poses_xy: Trajectory,
                    chosen: NDArray[np.bool_]) -> tuple[float, float, float]:
        """Return rms and worst piece's rms of the distances in mm, and the share left out."""
        path = self._drive.truth()
        driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.poses[:, :2],
                                                                    axis=0).T))])
        rng, found, left_out = np.random.default_rng(0), [], []
        chosen = chosen & (xyz[:, 2] > LOW) & (xyz[:, 2] < HIGH)
        for begin in np.arange(10.0, driven[-1] - 10.0 - PIECE, PIECE):
            middle = int(np.searchsorted(driven, begin + 0.5 * PIECE))
            correction = self._correction(poses_xy, int(path.stamps_ns[middle]))
            moved = geometry.compose(correction, np.column_stack(
                [xyz[:, :2], np.zeros(len(xyz))]))
            ahead = geometry.compose(geometry.inverse(path.poses[middle]), moved)[:, 0]
            own = np.flatnonzero(chosen & (np.abs(ahead) < 0.5 * PIECE))
            if len(own) < 2000:
                continue
            own = rng.choice(own, min(len(own), SAMPLE), replace=False)
            start = np.column_stack([moved[own, :2], xyz[own, 2]])
            off = self._aligned(start)
            good = off < TRIM
            found.append(off[good])
            left_out.append(1.0 - np.mean(good))
        pieces = [1e3 * np.sqrt(np.mean(o**2)) for o in found]
        return (1e3 * float(np.sqrt(np.mean(np.concatenate(found)**2))), float(max(pieces)),
                float(np.mean(left_out)))

    def _correction(self, path: Trajectory, stamp: int) -> Array:
        """Return the planar motion that takes a path's pose at a time to the true one."""
        true = true_poses(self._drive, np.array([stamp]))[0, [0, 1, 5]]
        return geometry.compose(true, geometry.inverse(path.at(stamp)[0]))

    def _aligned(self, xyz: Array) -> Array:
        """Return distances (n,) to the surfaces after rigid alignment; NaN beyond reach."""
        centre = xyz.mean(axis=0)
        turned, shift = Rotation.identity(), np.zeros(3)
        for _ in range(15):
            at = turned.apply(xyz - centre) + shift + centre
            off = at - self._surfaces.nearest(at)
            length = np.linalg.norm(off, axis=1)
            use = (length < TRIM) & (length > 1e-9)
            normal, arm = off[use] / length[use, None], at[use] - centre
            J = np.hstack([np.cross(arm, normal), normal])
            weight = 1.0 / (1.0 + (length[use] / 0.03) ** 2)
            step = np.linalg.lstsq((J.T * weight) @ J, -(J.T * weight) @ length[use],
                                   rcond=None)[0]
            turn = Rotation.from_rotvec(step[:3])
            turned, shift = turn * turned, turn.apply(shift) + step[3:]
            if np.abs(step).max() < 1e-5:
                break
        at = turned.apply(xyz - centre) + shift + centre
        return np.asarray(np.linalg.norm(at - self._surfaces.nearest(at), axis=1))

    def attitude_deg(self, mapped: Mapped) -> Array:
        """Return the rms error (2,) of roll and pitch in degrees."""
        error = mapped.poses[:, 3:5] - true_poses(self._drive, mapped.stamps)[:, 3:5]
        return np.rad2deg(np.sqrt(np.mean(error**2, axis=0)))


def columns(drive: Drive, points: FacadePoints) -> str:
    """Return the columns' figures: position, pitch, thickness of their fronts."""
    truth = np.array([[c['x'], c['y']] for c in drive.scene.facts['columns']])
    half = 0.5 * drive.scene.facts['columns'][0]['side']
    upright = (points.xyz[:, 2] > 1.0) & (points.xyz[:, 2] < 6.0) & (points.label == FACADE)
    xyz, found, thick = points.xyz[upright], [], []
    for x, y in truth:
        near = xyz[np.hypot(xyz[:, 0] - x, xyz[:, 1] - y) < 1.5]
        front = near[np.abs(near[:, 1] - (np.median(near[:, 1]) if len(near) else 0)) < 0.06]
        if len(front) < 300:
            continue
        # ends of the front face: where half of its usual density is reached
        count, edges = np.histogram(front[:, 0], bins=np.arange(x - 1.5, x + 1.5, 0.02))
        full = np.flatnonzero(count > 0.5 * np.percentile(count[count > 0], 75))
        middle = 0.5 * (edges[full[0]] + edges[full[-1] + 1])
        own = front[np.abs(front[:, 0] - middle) < half]
        slope = np.polyfit(own[:, 0], own[:, 1], 1)
        off = own[:, 1] - np.polyval(slope, own[:, 0])
        found.append((x, y, middle, float(np.polyval(slope, middle)) + half))
        thick.append(np.sqrt(np.mean(off**2)))
    f = np.array(found)
    error = np.hypot(f[:, 2] - f[:, 0], f[:, 3] - f[:, 1])
    pitch = np.diff(f[:, 2]) - np.diff(f[:, 0])
    return (f'{len(f)} columns: position error at most {error.max():.3f} m, pitch error '
            f'{1e3 * np.sqrt(np.mean(pitch**2)):.1f} mm rms, fronts '
            f'{1e3 * np.sqrt(np.mean(np.square(thick))):.1f} mm thick')


def report(name: str, options: Options) -> None:
    """Map one drive with both paths and print its figures."""
    drive = make_drive(name, options)
    scans, judge = list(drive.scans()), Judge(drive)
    pose = true_poses(drive, drive.truth().stamps_ns)
    print(f'{name} seed {options.seed}: roll, pitch '
          f'{np.round(np.rad2deg(pose[:, 3:5].std(axis=0)), 3)} deg rms, heave '
          f'{1e3 * pose[:, 2].std():.1f} mm', flush=True)
    mount = drive.vehicle.horizontal.T_base_laser[:3, 3]
    for what, path, pivot in (('true path', drive.truth(), np.zeros(3)),
                              ('estimated path', estimated_path(drive, scans), mount)):
        flat = Mapped(drive, scans, path, pivot, stabilise=False)
        done = Mapped(drive, scans, path, pivot)
        walls = done.points.label == FACADE
        best = perfect(drive, flat.points, flat, pivot)
        figures = []
        for xyz, along in ((done.points.xyz, path), (best, drive.truth()),
                           (flat.points.xyz, path)):
            figures.append((*(judge.distance_mm(xyz, done.points.stamps_ns, along, chosen)
                              for chosen in (walls | True, done.points.label != NOISE, walls)),
                            measure(xyz[walls], done.points.ring[walls])))
        a, b, c = figures
        roll, pitch = judge.attitude_deg(done)
        print(f'  {what}: roll {roll:.3f} pitch {pitch:.3f} deg')
        for n, text in enumerate(('all points', 'all but noise', 'facade class')):
            print(f'    {text}: {a[n][0]:.1f} mm (perfect {b[n][0]:.1f}, planar {c[n][0]:.1f}), '
                  f'worst piece {a[n][1]:.1f}, left out {100 * a[n][2]:.1f} %')
        print(f'    scanners agree within {a[3].agreement_mm:.1f} mm (perfect '
              f'{b[3].agreement_mm:.1f}, planar {c[3].agreement_mm:.1f}), planes '
              f'{a[3].thickness_mm:.1f} mm thick, lean {a[3].lean_deg:.2f} deg, doubled '
              f'{100 * a[3].doubled:.1f} %', flush=True)
        if name == 'campus':
            print('    ' + columns(drive, done.points))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1] if __doc__ else None)
    parser.add_argument('--scenes', nargs='+', default=['street', 'campus'])
    parser.add_argument('--seeds', nargs='+', type=int, default=[1, 2, 3])
    parser.add_argument('--duration', type=float, default=30.0)
    parser.add_argument('--vibration', type=float, default=1.8)
    args = parser.parse_args()
    for name in args.scenes:
        for seed in args.seeds if name != 'campus' else args.seeds[:1]:
            report(name, Options(seed, args.duration, 1.0 if name == 'campus' else
                                 args.vibration))


if __name__ == '__main__':
    main()
