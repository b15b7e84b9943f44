# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
How many points a second the facade aligner places on one core, and in how much memory.

    python benchmarks/aligner.py [--seconds 60] [--folder DIR]

Three vertical scanners at 75 Hz on a street of road, kerb and broken walls, all rays hitting
something; poses of every scan in pieces of 64 as `stri-mapping map` gives them.  The time is the
process's own in `add_scan`, `add_poses`, `take_points` and `take_poses`, stabilisation and
classes included; with a folder, the files are written as well, and their time is told apart.
Memory is the most that the process ever held.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import resource
import time

import numpy as np

from stri_mapping import geometry
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.facade.writer import FacadeWriter
from stri_mapping.scan import make_scan, Scan
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

TURN_NS = 13_320_000
PIECE = 64
POOL = 400


def make_scans(rng: np.random.Generator) -> list[Scan]:
    """Return scans of a street 9 m wide from a scanner 1.9 m up, windows and kerb included."""
    angles = np.deg2rad(np.arange(-90.0, 91.0))
    down = np.where(angles < 0.0, -1.9 / np.minimum(np.sin(angles), -1e-3), 80.0)
    kerb = np.where(angles < -0.03, -1.78 / np.minimum(np.sin(angles), -1e-3), 80.0)
    kerb[kerb * np.cos(angles) < 6.2] = 80.0
    found = []
    for _ in range(POOL):
        depth = np.where(rng.random(181) < 0.3, 9.3, 9.0)
        wall = np.minimum(depth / np.maximum(np.cos(angles), 0.12), 40.0)
        ranges = np.minimum(np.minimum(down, kerb), wall) + rng.normal(0.0, 0.01, 181)
        found.append(make_scan(0, np.round(ranges, 2), -0.5 * np.pi, float(np.deg2rad(1.0)),
                               TURN_NS * 1e-9 / 360.0, 0.0, 80.0, rng.uniform(5.0, 90.0, 181)))
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1] if __doc__ else None)
    parser.add_argument('--seconds', type=float, default=60.0, help='length of the drive')
    parser.add_argument('--folder', type=Path, help='write the files of the cloud here')
    args = parser.parse_args()
    count = int(args.seconds * 1e9) // TURN_NS
    scanners = load_vehicle(default_vehicle_file()).verticals
    pool = make_scans(np.random.default_rng(1))
    aligner, points, took, writing = FacadeAligner(scanners), 0, 0.0, 0.0
    aligner.warm_up()
    writer = FacadeWriter(args.folder, [s.name for s in scanners]) if args.folder else None
    for first in range(0, count, PIECE):
        numbers = np.arange(first, min(first + PIECE, count))
        scans = [[replace(pool[(3 * i + 7 * ring) % POOL], stamp_ns=int(i) * TURN_NS + 4_000_000
                          * ring) for i in numbers] for ring in range(len(scanners))]
        stamps = numbers * TURN_NS
        poses = geometry.exp((stamps * 1e-9)[:, None] * [8.0, 0.0, 0.002])
        began = time.process_time()
        for ring, own in enumerate(scans):
            for scan in own:
                aligner.add_scan(ring, scan)
        aligner.add_poses(stamps, poses)
        if writer is None:
            points += len(aligner.take_points())
            aligner.take_poses()
        else:
            points += len(writer.take(aligner))
        took += time.process_time() - began
    if writer is not None:
        began = time.process_time()
        writer.close()
        writing = time.process_time() - began
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1e-6
    print(f'{points} points in {took:.2f} s: {points / took * 1e-6:.2f} million a second, '
          f'{args.seconds / took:.0f} times real time; {memory:.2f} GB'
          + (f'; {writing:.1f} s more for the LAZ' if writer else ''))


if __name__ == '__main__':
    main()
