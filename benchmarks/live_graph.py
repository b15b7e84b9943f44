# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The whole live graph on a virtual drive: processor shares, latency, losses, drift.

    python benchmarks/live_graph.py [--scene street] [--duration 60] [--folder DIR]

It runs `stri-mapping run --simulate`, with recorder, and beside it listens to the odometry, which
takes some 2 % of a processor.  Then it maps the recorded bag offline and plays it through the
nodes five times faster.  Results of runs are in docs/graph.md.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

import numpy as np

TICKS = os.sysconf('SC_CLK_TCK')
# Seconds of the last ray after a scan's stamp: half a turn of the mirror.
LAST_RAY = 0.01332 / 2


def command(*arguments: object) -> list[str]:
    """Return a command line of this package."""
    return [sys.executable, '-m', 'stri_mapping.cli', *map(str, arguments)]


def name_of(cmdline: list[str]) -> str:
    """Return the node that a process is, from its command line."""
    words = ' '.join(cmdline)
    if 'nodes.spare' in words:
        return f'spare {words.split("nodes.spare ")[1].split()[0]}'
    if 'stri_mapping.nodes.' in words:
        return words.split('stri_mapping.nodes.')[1].split()[0]
    return 'supervisor' if 'stri_mapping.cli' in words else 'helper'


def processes(supervisor: int) -> dict[int, tuple[str, float, float]]:
    """Return by process id: node, processor seconds and resident megabytes."""
    mark = f'STRI_MAPPING_SUPERVISOR={supervisor}'.encode()
    found, groups = {}, {}
    for entry in Path('/proc').iterdir():
        try:
            if not entry.name.isdigit() or (int(entry.name) != supervisor and mark not in (
                    entry / 'environ').read_bytes().split(b'\0')):
                continue
            fields = (entry / 'stat').read_text().rpartition(')')[2].split()
            words = (entry / 'cmdline').read_bytes().decode().replace('\0', ' ').split()
        except OSError:
            continue
        pid, group = int(entry.name), int(fields[2])
        name = name_of(words)
        groups.setdefault(group, name)
        found[pid] = (name if name != 'helper' else f'{groups[group]} helper',
                      (int(fields[11]) + int(fields[12])) / TICKS,
                      int(fields[21]) * os.sysconf('SC_PAGE_SIZE') / 1e6)
    return found


class OdometryListener:
    """Notes when each odometry came, by the clock of the middleware."""

    def __init__(self) -> None:
        """Subscribe."""
        from nav_msgs.msg import Odometry
        import rclpy

        from stri_mapping.nodes.polling import Polled
        rclpy.init()
        self.node = rclpy.create_node('benchmark')
        self._subscription = self.node.create_subscription(
            Odometry, 'odom', lambda _: None, 1000, raw=True, callback_group=Polled())
        self.stamps: list[int] = []
        self.received: list[int] = []

    def take(self) -> None:
        """Take what has come."""
        from stri_mapping.nodes.polling import take_all
        from stri_mapping.nodes.raw_output import header_stamp_ns
        for data, info in take_all(self._subscription):
            self.stamps.append(header_stamp_ns(data))
            self.received.append(info['received_timestamp'])


def watch(process: subprocess.Popen[bytes], seconds: float) -> tuple[dict[str, list[float]],
                                                                     OdometryListener]:
    """Sample the processes while the vehicle drives; return shares and memory by node."""
    listener = OdometryListener()
    while process.poll() is None and not listener.stamps:
        listener.take()
        time.sleep(0.2)
    time.sleep(3.0)                             # caches and spares are in place
    begun, first = time.monotonic(), processes(process.pid)
    last, ended = first, begun
    while process.poll() is None and time.monotonic() < begun + seconds:
        listener.take()
        time.sleep(0.5)
        if process.poll() is None:
            last, ended = processes(process.pid), time.monotonic()
    shares: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for pid, (name, cpu, memory) in last.items():
        before = first.get(pid, ('', 0.0, 0.0))[1]
        shares[name][0] += (cpu - before) / (ended - begun)
        shares[name][1] += memory
    while process.poll() is None:
        listener.take()
        time.sleep(0.2)
    return shares, listener


def errors(folder: Path, truth: Path) -> dict[str, float]:
    """Return the errors of results against the truth in a bag."""
    subprocess.run(command('evaluate', folder, '--truth', truth), check=True,
                   stdout=subprocess.DEVNULL)
    return dict(json.loads((folder / 'evaluation.json').read_text())['errors'])


def report(shares: dict[str, list[float]], listener: OdometryListener, live: Path) -> None:
    """Print shares, latency and losses."""
    for name, (share, memory) in sorted(shares.items(), key=lambda item: -item[1][0]):
        print(f'{name:28} {100 * share:6.1f} %  {memory:6.0f} MB')
    print(f'{"all":28} {100 * sum(s for s, _ in shares.values()):6.1f} %')
    stamps, received = np.array(listener.stamps), np.array(listener.received)
    latency = (received - stamps) * 1e-6 - 1e3 * LAST_RAY
    p50, p95, p99 = np.percentile(latency, [50, 95, 99])
    rate = (len(stamps) - 1) / ((stamps[-1] - stamps[0]) * 1e-9)
    print(f'odometry: {rate:.2f} Hz, after the last ray p50 {p50:.1f} ms, p95 {p95:.1f} ms, '
          f'p99 {p99:.1f} ms, max {latency.max():.0f} ms')
    summary = json.loads((live / 'summary.json').read_text())
    lost = {s['name']: s['lost_scans'] for s in summary['scanners']}
    print(f'lost scans: {lost}; {summary["messages"]}')


def main() -> int:
    """Run, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--scene', default='street')
    parser.add_argument('--duration', type=float, default=60.0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--folder', type=Path)
    args = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    folder = args.folder or Path(tempfile.mkdtemp(prefix='live-graph-'))
    folder.mkdir(parents=True, exist_ok=True)
    bag = folder / 'bag'
    print(f'load before: {os.getloadavg()[0]:.2f} on {os.cpu_count()} processors; {folder}')
    with (folder / 'log.txt').open('wb') as log:
        process = subprocess.Popen(command(
            'run', '--simulate', args.scene, '--seed', args.seed, '--duration', args.duration,
            '--record', bag, '--output', folder / 'live'), stdout=log, stderr=log)
        shares, listener = watch(process, args.duration)
    report(shares, listener, folder / 'live')
    subprocess.run(command('map', bag, '--output', folder / 'offline'), check=True,
                   stdout=subprocess.DEVNULL)
    subprocess.run(command('run', '--bag', bag, '--rate', 5, '--output', folder / 'fast'),
                   check=True, stdout=subprocess.DEVNULL)
    for name in ('live', 'offline', 'fast'):
        found = errors(folder / name, bag)
        summary = json.loads((folder / name / 'summary.json').read_text())
        drift = {key: round(value, 4) for key, value in found.items()
                 if value is not None and 'drift' in key}
        print(f'{name:8} {summary["poses"]} poses, {summary["points"]} points, '
              f'{summary["lost_scans"]} lost, {drift}')
    return process.returncode


if __name__ == '__main__':
    sys.exit(main())
