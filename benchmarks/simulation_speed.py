# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure how fast virtual drives are made, four scanners and the bag, on one core.

Seconds are those of the processor, so that what else the machine does does not count.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import tempfile
import time

from stri_mapping.simulation.drive import make_drive
from stri_mapping.simulation.record import record
from stri_mapping.simulation.scenes import Options


def main() -> None:
    """Print one line a scene; compiling is done before the clock starts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scenes', nargs='*', default=['campus', 'street', 'city'])
    parser.add_argument('--duration', type=float, default=30.0)
    args = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        record(make_drive('street', Options(duration=1.0)), Path(folder) / 'compiled')
        print('scene      triangles  build s  drive s  made in s  times real time   ms a turn')
        for name in args.scenes:
            began = time.process_time()
            drive = make_drive(name, Options(duration=args.duration))
            built = time.process_time()
            scans = record(drive, Path(folder) / name)
            took = time.process_time() - built
            print(f'{name:10} {len(drive.scene.mesh):9d}  {built - began:7.1f}'
                  f'  {args.duration:7.1f}  {took:9.1f}  {args.duration / took:15.1f}'
                  f'  {1e3 * took / scans:10.2f}')


if __name__ == '__main__':
    main()
