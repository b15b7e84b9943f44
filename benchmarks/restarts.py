# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
When a node of the live graph killed by kill -9 is back, and what the drive lacks after it.

    python benchmarks/restarts.py [--scene street] [--rounds 1]

It runs `stri-mapping run --simulate` with a recorder, kills the nodes one after the other, and
tells how long after the kill of a driver, the estimator or the aligner its next message left.
Then it looks for the hole that each death has left: a driver's and the virtual vehicle's in the
recorded scans, the estimator's in the path, the aligner's in the cloud, the recorder's in its bag.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / 'test'))

import live

from stri_mapping.bag_io import Bag
from stri_mapping.facade.cloud_files import read_ply
from stri_mapping.trajectory import read_tum

NODES = ('sick_lms_driver', 'stri_estimator', 'facade_aligner', 'bag_recorder',
         'virtual_vehicle')
SCANS = '/horizontal/scan'
# Seconds between two kills, so that each meets a graph at work; spares are ready by then.
REST = 10.0


def processes(supervisor: int) -> dict[str, int]:
    """Return the process of each node; of the drivers, the horizontal scanner's."""
    found = {}
    for pid in live.node_pids(supervisor):
        try:
            line = Path(f'/proc/{pid}/cmdline').read_bytes().replace(b'\0', b' ').decode()
        except OSError:                     # it has ended meanwhile
            continue
        for name in NODES:
            if f'stri_mapping.nodes.{name} ' in line and (
                    name != 'sick_lms_driver' or '__ns:=/horizontal' in line):
                found[name] = pid
    return found


class Witness:
    """Hears what the nodes give that killed ones gave."""

    def __init__(self) -> None:
        """Subscribe."""
        from nav_msgs.msg import Odometry
        import rclpy
        from sensor_msgs.msg import LaserScan, PointCloud2

        from stri_mapping.nodes.polling import Polled
        rclpy.init()
        self.node = rclpy.create_node('benchmark')
        topics = {'sick_lms_driver': (LaserScan, SCANS), 'stri_estimator': (Odometry, 'odom'),
                  'facade_aligner': (PointCloud2, 'facade/points')}
        self._subscriptions = {name: self.node.create_subscription(
            kind, topic, lambda _: None, 1000, raw=True, callback_group=Polled())
            for name, (kind, topic) in topics.items()}

    def back_after(self, name: str, kill: float) -> float | None:
        """Return how many seconds after its kill a node gave something; None if not heard."""
        from stri_mapping.nodes.polling import take_all
        sent: list[float] = []
        if name not in self._subscriptions:
            return None

        def heard() -> bool:
            sent.extend(1e-9 * info['source_timestamp']
                        for _, info in take_all(self._subscriptions[name]))
            return any(time > kill for time in sent)
        live.wait_until(heard, f'something from {name}')
        return min(time for time in sent if time > kill) - kill


def kill_all(supervisor: int, rounds: int) -> list[tuple[str, float]]:
    """Kill each node; return names and host times."""
    kills, witness = [], Witness()
    for name in rounds * NODES:
        time.sleep(REST)
        before = processes(supervisor)
        kills.append((name, time.time()))
        os.kill(before[name], signal.SIGKILL)
        live.wait_until(lambda n=name, b=before: processes(supervisor).get(n, b[n]) != b[n],
                        f'{name} again')
        after = processes(supervisor)
        affected = [other for other in NODES if other != name and after[other] != before[other]]
        back = witness.back_after(name, kills[-1][1])
        print(f'{name} killed' + ('' if back is None else f', back after {back:.2f} s')
              + (f'; {affected} affected' if affected else ''), flush=True)
    time.sleep(REST)
    return kills


def products(folder: Path) -> dict[str, np.ndarray]:
    """Return by node the times, in seconds and in order, of what it has given."""
    with Bag(folder / 'bag') as bag:
        log, stamps = [], []
        for connection, received_ns, data in bag.raw_messages():
            log.append(received_ns)
            if connection.topic == SCANS:
                seconds, nanoseconds = np.frombuffer(data, '<u4', 2, offset=4)
                stamps.append(int(seconds) * 10**9 + int(nanoseconds))
    points = [np.unique(rows['time']) for rows in read_ply(folder / 'out/facade.ply')]
    scans = np.sort(1e-9 * np.array(stamps))
    return {'sick_lms_driver': scans, 'virtual_vehicle': scans,
            'bag_recorder': np.sort(1e-9 * np.array(log)),
            'stri_estimator': 1e-9 * read_tum(folder / 'out/trajectory.tum').stamps_ns,
            'facade_aligner': np.unique(np.concatenate(points))}


def hole(times: np.ndarray, at: float) -> float:
    """Return the longest step between times near a moment: what came shortly before may lack."""
    near = times[(times > at - 5.0) & (times < at + 2.0 * REST)]
    return float(np.diff(near).max())


def main() -> int:
    """Run, kill, print."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--scene', default='street')
    parser.add_argument('--rounds', type=int, default=1)
    args = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    folder = Path(tempfile.mkdtemp(prefix='restarts-'))
    print(f'load before: {os.getloadavg()[0]:.2f} on {os.cpu_count()} processors; {folder}')
    with (folder / 'log.txt').open('wb') as log:
        process = subprocess.Popen(
            [sys.executable, '-m', 'stri_mapping.cli', 'run', '--simulate', args.scene,
             '--duration', str(60.0 + 1.5 * REST * args.rounds * len(NODES)),
             '--record', str(folder / 'bag'), '--output', str(folder / 'out')],
            stdout=log, stderr=log)
        try:
            live.wait_until((folder / 'out/facade.ply').is_file, 'points')
            kills = kill_all(process.pid, args.rounds)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(120)
    print(f'load after: {os.getloadavg()[0]:.2f}')
    given = products(folder)
    for name, at in kills:
        print(f'{name:16} {hole(given[name], at):5.2f} s missing')
    summary = json.loads((folder / 'out/summary.json').read_text())
    print(f'gaps told: {[f"{b - a:.2f} s" for a, b in summary["gaps"]]}; {summary["poses"]} poses '
          f'of {summary["scans"]} scans, lost scans '
          f'{ {s["name"]: s["lost_scans"] for s in summary["scanners"]} }')
    print('\n'.join(summary['messages']))
    return 0


if __name__ == '__main__':
    sys.exit(main())
