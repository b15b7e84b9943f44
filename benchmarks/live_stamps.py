# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Compare the stamps of a recorded live drive with the mirrors' own times.

    stri-mapping run --simulate street --duration 20 --record drive --output drive-map
    python benchmarks/live_stamps.py drive

The virtual vehicle's diagnostics, which the bag holds, tell when every turn of every mirror began.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores

# Seconds that a driver may take to know its mirror.
SETTLED = 5.0


def read(path: Path) -> tuple[dict[str, str], dict[str, list[int]]]:
    """Return what the virtual vehicle says of itself, and the stamps by scanner in ns."""
    told: dict[str, str] = {}
    stamps: dict[str, list[int]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:
        for connection, _, data in bag.messages():
            if connection.topic == '/diagnostics' and not told:
                for status in bag.deserialize(data, connection.msgtype).status:
                    if status.name.startswith('virtual_vehicle'):
                        told = {value.key: value.value for value in status.values}
            elif connection.topic.endswith('/scan'):
                stamp = bag.deserialize(data, connection.msgtype).header.stamp
                name = connection.topic.strip('/').removesuffix('/scan')
                stamps.setdefault(name, []).append(stamp.sec * 10**9 + stamp.nanosec)
    return told, stamps


def main() -> None:
    """Print one line a scanner."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('bag', type=Path)
    told, stamps = read(parser.parse_args().bag)
    print(f'{"scanner":14}  scans  missing  error after {SETTLED:.0f} s, ms: mean    rms    max')
    for name, values in sorted(stamps.items()):
        phase, period = (float(v) for v in told[f'{name}: turn 0, turn (s)'].split(','))
        seconds = 1e-9 * (np.array(values) - int(told['Second 0 (ns)']))
        turns = np.round((seconds - phase) / period)
        error = 1e3 * (seconds - phase - turns * period)[seconds > seconds[0] + SETTLED]
        rms, missing = np.sqrt(np.mean(error**2)), int(np.sum(np.diff(turns) - 1))
        print(f'{name:14} {len(values):6d} {missing:8d} {error.mean():28.3f} {rms:6.3f}'
              f' {np.abs(error).max():6.3f}')


if __name__ == '__main__':
    main()
