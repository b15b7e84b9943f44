# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Look at ten seeds of a scene: valid, different from one another, their motion to be seen.

Motion counts as observable in a turn of the horizontal scanner's mirror if that turn alone tells
the position along the way to better than 2 cm, twice the noise of a ray: the standard deviation
of that position, heading and sideways position being unknown too, from the distances of all rays
to the surfaces that stand still (10 mm each, met at less than 75 degrees, leaves left out).
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from stri_mapping.scan import MIRROR_TURN
from stri_mapping.simulation.beam import SUB_RAYS, sub_rays
from stri_mapping.simulation.drive import Drive, make_drive
from stri_mapping.simulation.scenes import Options
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, Vehicle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
NOISE, LIMIT, INTERVAL = 0.010, 0.02, 0.1


def along_sigma(drive: Drive, time: float, normals: Array, leaves: Mask) -> float:
    """
    Return the standard deviation in metres of the position along the way from one turn.

    Of the still triangles, `normals` (m, 2) are those seen from above and `leaves` (m,) tells
    the ones that do not count.
    """
    scene, scanner = drive.scene, drive.scanners[0]
    bearings = np.deg2rad(scanner.model.bearings(0))
    times = np.asarray(time + MIRROR_TURN * np.arange(len(bearings)) / 360.0)
    poses = scene.motion.at(times)
    origins, directions = sub_rays(poses, bearings, scanner.scanner.T_base_laser, 0.0, 0.0)
    seen, _ = scene.look(times, origins, directions)
    origins, directions = origins[::SUB_RAYS], directions[::SUB_RAYS]
    distance, cosine, triangle = scene.still.cast(origins, directions)
    met = (distance < 30.0) & (cosine > np.cos(np.deg2rad(75.0))) & ~leaves[triangle]
    met &= seen[::SUB_RAYS] > np.where(met, distance, np.inf) - 0.05      # no mover before it
    normal = normals[triangle[met]]
    arm = origins[met, :2] + distance[met, None] * directions[met, :2] - poses[0, :2]
    ahead = np.array([np.cos(poses[0, 5]), np.sin(poses[0, 5])])
    aside = np.array([-ahead[1], ahead[0]])
    J = np.column_stack([normal @ ahead, normal @ aside,
                         arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0]]) / NOISE
    information = J.T @ J + np.diag([1e-4, 1e-4, 1e-4])
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


def main() -> None:
    """Print one line a seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scene', nargs='?', default='street')
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--duration', type=float)
    args = parser.parse_args()
    vehicle = Vehicle((load_vehicle(default_vehicle_file()).horizontal,))
    first: dict[bytes, int] = {}
    print('seed  metres  km/h        rays with a range %  observable %  longest blind s')
    for seed in range(1, args.seeds + 1):
        drive = make_drive(args.scene, Options(seed, args.duration), vehicle=vehicle)
        scans = [t.scan for t in drive.scans()]
        ranges = np.array([s.ranges for s in scans])
        twin = first.setdefault(ranges[::50].tobytes(), seed)
        times = np.arange(0.0, drive.scene.duration - 0.1, INTERVAL)
        mesh = drive.scene.mesh
        normals = mesh.normals[:, :2]
        leaves = np.array([s.name == 'leaves' for s in mesh.surfaces])[mesh.surface]
        blind = np.array([along_sigma(drive, t, normals, leaves) for t in times]) > LIMIT
        edges = np.flatnonzero(np.diff(np.concatenate([[0], blind.astype(int), [0]])))
        longest = INTERVAL * max(edges[1::2] - edges[::2], default=0)
        speed = 3.6 * drive.scene.motion.twist(times)[:, 0]
        metres = drive.facts()['distance_m']
        print(f'{seed:4d} {metres:7.1f}  {speed.min():5.1f}-{speed.max():4.1f}'
              f'  {100 * np.isfinite(ranges).mean():18.1f}  {100 * (1 - blind.mean()):12.1f}'
              f'  {longest:15.1f}' + ('' if twin == seed else f'  the same as seed {twin}!'))


if __name__ == '__main__':
    main()
