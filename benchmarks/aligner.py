# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
How many points a second the facade aligner places on one core.

    python benchmarks/aligner.py [--seconds 60]

Three vertical scanners at 75 Hz, 181 rays that all hit something, poses of every scan in pieces
of 64 as `stri-mapping map` gives them; the time is that of `add_scan`, `add_poses` and
`take_points` together.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from stri_mapping import geometry
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.scan import make_scan, Scan
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

TURN_NS = 13_320_000
PIECE = 64


def make_scans(count: int, rng: np.random.Generator) -> list[Scan]:
    """Return scans of random ranges, one a mirror turn."""
    step = float(np.deg2rad(1.0))
    return [make_scan(i * TURN_NS, rng.uniform(3.0, 20.0, 181), -0.5 * np.pi, step,
                      TURN_NS * 1e-9 / 360.0, 0.1, 80.0) for i in range(count)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument('--seconds', type=float, default=60.0, help='length of the drive')
    count = int(parser.parse_args().seconds * 1e9) // TURN_NS
    scanners = load_vehicle(default_vehicle_file()).verticals
    rng = np.random.default_rng(1)
    scans = [make_scans(count, rng) for _ in scanners]
    stamps = np.arange(count, dtype=np.int64) * TURN_NS
    poses = geometry.exp((stamps * 1e-9)[:, None] * [8.0, 0.0, 0.02])

    aligner, points = FacadeAligner(scanners), 0
    began = time.perf_counter()
    for first in range(0, count, PIECE):
        piece = slice(first, first + PIECE)
        for ring, own in enumerate(scans):
            for scan in own[piece]:
                aligner.add_scan(ring, scan)
        aligner.add_poses(stamps[piece], poses[piece])
        points += len(aligner.take_points())
    took = time.perf_counter() - began
    print(f'{points} points in {took:.2f} s: {points / took * 1e-6:.2f} million a second, '
          f'{count * TURN_NS * 1e-9 / took:.0f} times real time')


if __name__ == '__main__':
    main()
