# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Memory, open files and threads of every node over a long run.

    python benchmarks/soak.py BAG [--minutes 6] [--rate 10]

It plays the bag again and again through recorder, estimator and aligner, samples the processes
every ten seconds, and prints for each its resident memory at each quarter, its slope over the
second half, with the standard error that its noise gives, and what its open files and threads
came to.  Since the player does not run ahead of the odometry, the rate is what the machine
manages: how much driving was played is counted in the scans that were recorded.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np

from stri_mapping.bag_io import Bag

PAGE = os.sysconf('SC_PAGE_SIZE')
PERIOD = 10.0


def start(module: str, *parameters: str) -> subprocess.Popen[bytes]:
    """Start a node on its own."""
    given = [part for each in parameters for part in ('-p', each)]
    return subprocess.Popen([sys.executable, '-m', f'stri_mapping.nodes.{module}', '--ros-args',
                             *given], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def sample(pid: int) -> tuple[float, int, int]:
    """Return resident megabytes, open files and threads of a process."""
    folder = Path(f'/proc/{pid}')
    memory = int((folder / 'statm').read_text().split()[1]) * PAGE / 1e6
    return memory, len(list((folder / 'fd').iterdir())), len(list((folder / 'task').iterdir()))


def passes(source: Path, recorded: Path) -> tuple[float, float]:
    """Return how many times a bag was played, by its recorded scans, and its length in hours."""
    with Bag(source) as bag, Bag(recorded) as copy:
        count = [sum(b.message_count(topic) for topic in bag.scan_topics) for b in (bag, copy)]
        return count[1] / count[0], bag.duration_ns / 3.6e12


def slope(hours: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Return the slope of a line through values, and its standard error."""
    A = np.column_stack([hours - hours.mean(), np.ones_like(hours)])
    fit, *_ = np.linalg.lstsq(A, values, rcond=None)
    spread = np.std(values - A @ fit, ddof=2)
    return float(fit[0]), float(spread / np.linalg.norm(A[:, 0]))


def main() -> int:
    """Run, sample, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag', type=Path)
    parser.add_argument('--minutes', type=float, default=6.0)
    parser.add_argument('--rate', type=float, default=10.0)
    args = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    folder = Path(tempfile.mkdtemp(prefix='soak-'))
    nodes = {
        'bag_player': start('bag_player', f'bag:={args.bag}', f'rate:={args.rate}', 'loop:=true',
                            'follow:=odom', 'subscribers:=/horizontal/scan'),
        'stri_estimator': start('stri_estimator', 'tf_static_wait:=0.0'),
        'facade_aligner': start('facade_aligner', 'tf_static_wait:=0.0'),
        'bag_recorder': start('bag_recorder', f'path:={folder / "bag"}', 'split_size:=100.0')}
    samples: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    begun = time.monotonic()
    try:
        while (passed := time.monotonic() - begun) < 60.0 * args.minutes:
            time.sleep(PERIOD)
            for name, process in nodes.items():
                if process.poll() is not None:
                    print(f'{name} ended with {process.returncode} after {passed:.0f} s')
                    return 1
                samples[name].append((passed, *sample(process.pid)))
    finally:
        for process in nodes.values():
            process.send_signal(signal.SIGINT)
            process.wait(120)
    times, length = passes(args.bag, folder / 'bag')
    print(f'{args.minutes:g} min at rate {args.rate:g} at most: {times * length:.2f} h of driving '
          f'in {times:.1f} passes; second half:')
    for name, rows in samples.items():
        late = np.array(rows[len(rows) // 2:])
        rate, error = slope(late[:, 0] / 3600.0, late[:, 1])
        quarters = ' '.join(f'{rows[len(rows) * k // 4 - 1][1]:.1f}' for k in (1, 2, 3, 4))
        print(f'{name:16} {quarters} MB  {rate:+7.2f} +- {error:.2f} MB/h   files '
              f'{late[0, 2]:.0f} to {late[-1, 2]:.0f}   threads {late[0, 3]:.0f} to '
              f'{late[-1, 3]:.0f}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
