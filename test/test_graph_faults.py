# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What kills nodes, or all of them: the drive goes on, and what was recorded is there."""

from __future__ import annotations

import os

import live
import numpy as np
import pytest

from stri_mapping.bag_io import Bag
from stri_mapping.facade.cloud_files import read_ply
from stri_mapping.recording.repair import repair
from stri_mapping.summary import read_summary
from stri_mapping.trajectory import read_tum

pytestmark = [live.needs_ros, pytest.mark.skipif(
    not live.CAMPUS.is_dir(), reason=f'{live.CAMPUS} is not there')]

SCANS = '/horizontal/scan'


def kill_and_await(supervisor: int, module: str) -> None:
    """Kill a node, and wait until another process has its place."""
    before = live.node_pid(supervisor, module)
    os.kill(before, 9)

    def back() -> bool:
        try:
            return live.node_pid(supervisor, module) != before
        except StopIteration:
            return False

    live.wait_until(back, f'{module} again')


def test_each_node_comes_back_when_killed_and_the_result_lacks_only_the_gap(tmp_path):
    out, trajectory = tmp_path / 'out', tmp_path / 'out/trajectory.tum'
    with live.command('run', '--bag', live.CAMPUS, '--record', tmp_path / 'bag', '--output', out,
                      env=live.environment()) as process:
        live.wait_until(lambda: live.line_count(trajectory) > 300, 'poses')
        others = {name: live.node_pid(process.pid, name) for name in ('facade_aligner',
                                                                     'bag_recorder')}
        kill_and_await(process.pid, 'stri_estimator')
        known = live.line_count(trajectory)
        live.wait_until(lambda: live.line_count(trajectory) > known + 75, 'poses after the kill')
        for name, pid in others.items():
            assert live.node_pid(process.pid, name) == pid
        for victim in ('facade_aligner', 'bag_recorder', 'bag_player'):
            kill_and_await(process.pid, victim)
            known = live.line_count(trajectory)
            live.wait_until(lambda n=known + 75: live.line_count(trajectory) > n,
                            f'poses after the kill of {victim}')
        output, _ = process.communicate(timeout=live.TIMEOUT)
        assert process.returncode == 0, output
        assert live.node_pids(process.pid) == []
    assert 'Traceback' not in output
    summary = read_summary(out)
    assert summary['complete'] is False
    for name in ('stri_estimator', 'facade_aligner', 'bag_recorder', 'bag_player'):
        assert f'{name} was killed by SIGKILL; it was started again' in summary['messages']
    # one gap, which is reported; before and after it a pose for every scan
    path = read_tum(trajectory)
    steps = np.diff(path.stamps_ns) * 1e-9
    (start, end), = summary['gaps']
    assert end - start == pytest.approx(steps.max(), abs=1e-6)
    assert any('no pose for' in text for text in summary['warnings'])
    assert summary['poses'] == pytest.approx(2552 - (end - start) / 0.01332, abs=5)
    # what came is counted also where who counted was killed: the player waits for its readers,
    # and what came while nobody read is told as lost
    for scanner in summary['scanners']:
        assert scanner['scans'] + scanner['lost_scans'] == pytest.approx(2552, abs=3)
    # the path goes on where it was: at most 11 km/h more or less than before, REP-105
    gap = int(np.argmax(steps))
    moved = np.hypot(*(path.poses[gap + 1] - path.poses[gap])[:2])
    speed = np.hypot(*(path.poses[gap] - path.poses[gap - 30])[:2]) / (
        (path.stamps_ns[gap] - path.stamps_ns[gap - 30]) * 1e-9)
    assert moved / steps[gap] == pytest.approx(speed, abs=3.0)
    # points from before the aligner's death as well as after it
    times = np.concatenate([rows['time'] for rows in read_ply(out / 'facade.ply')])
    assert times.min() < start
    assert times.max() > path.stamps_ns[-1] * 1e-9 - 1.0
    # the recording: both parts in one bag that reads as one
    with Bag(tmp_path / 'bag') as bag:
        assert len(list((tmp_path / 'bag').glob('*.mcap'))) == 2
        assert bag.message_count(SCANS) > 0.8 * 2552


def test_everything_killed_while_recording_costs_less_than_a_hundredth(tmp_path):
    from sensor_msgs.msg import LaserScan
    heard: list[bytes] = []
    with live.listener() as (own, executor, env), live.command(
            'run', '--bag', live.CAMPUS, '--record', tmp_path / 'bag', '--output',
            tmp_path / 'out', env=env) as process:
        own.create_subscription(LaserScan, SCANS, lambda data: heard.append(bytes(data)),
                                live.lossless(), raw=True)
        live.spin_until(executor, lambda: len(heard) > 600, 'scans')
        for pid in [*live.node_pids(process.pid), process.pid]:
            os.kill(pid, 9)
        process.wait()
    done = repair(tmp_path / 'bag')
    assert done.mended == ['bag_0.mcap']
    with Bag(tmp_path / 'bag') as bag:
        kept = {bytes(data) for _, _, data in bag.raw_messages([SCANS])}
    assert sum(data in kept for data in heard) >= 0.99 * len(heard)


@pytest.fixture
def disk(tmp_path):
    with live.small_disk(tmp_path, '700k') as folder:
        yield folder


def test_a_full_disk_stops_the_recording_but_not_the_drive(disk, tmp_path):
    short = live.cut_bag(live.CAMPUS, tmp_path / 'short', 8.0)
    code, output = live.shown(
        ['run', '--bag', short, '--rate', 3, '--record', disk / 'bag', '--output',
         tmp_path / 'out'],
        live.environment())
    assert code == 1, output
    assert 'recording stopped' in output
    assert 'Traceback' not in output
    summary = read_summary(tmp_path / 'out')
    assert summary['lost_scans'] == 0
    assert summary['poses'] == summary['scans'] > 590
    assert any('bag_recorder failed' in text for text in summary['messages'])
    with Bag(disk / 'bag') as bag:
        assert bag.message_count(SCANS) > 50


def test_results_on_a_full_disk_end_but_the_drive_does_not(tmp_path):
    short = live.cut_bag(live.CAMPUS, tmp_path / 'short', 12.0)
    with live.small_disk(tmp_path, '12m') as disk:
        code, output = live.shown(
            ['run', '--bag', short, '--rate', 3, '--record', tmp_path / 'bag', '--output',
             disk / 'out'], live.environment())
        assert code == 1, output
        assert 'No space left on device; the drive goes on, its results do not' in output
        assert 'Traceback' not in output and 'started again' not in output
        summary = read_summary(disk / 'out')
        assert summary['complete'] is False
        assert 0 < summary['points'] == sum(map(len, read_ply(disk / 'out/facade.ply')))
        assert len(read_tum(disk / 'out/trajectory.tum')) == summary['poses'] > 0
    with Bag(tmp_path / 'bag') as bag:          # odometry of every scan, results or not
        assert bag.message_count('/odom') > 0.75 * bag.message_count(SCANS) > 600
