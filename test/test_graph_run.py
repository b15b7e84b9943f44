# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The live graph: real processes over real DDS give what the offline command gives."""

from __future__ import annotations

import os
from pathlib import Path

import live
import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.facade.cloud_files import count_points, read_ply
from stri_mapping.facade.writer import STABILISED_NAME
from stri_mapping.summary import read_summary
from stri_mapping.trajectory import read_spatial_tum, read_tum

pytestmark = [live.needs_ros, pytest.mark.skipif(
    not live.CAMPUS.is_dir(), reason=f'{live.CAMPUS} is not there')]


@pytest.fixture(scope='module')
def short_bag(tmp_path_factory) -> Path:
    """Return six seconds of the drive, with an odometry recorded that must not be played."""
    return live.cut_bag(live.CAMPUS, tmp_path_factory.mktemp('bags') / 'short', 6.0,
                        {'/ground_truth/odom': '/odom'})


def assert_same(offline: Path, online: Path) -> None:
    """Require every pose within 5 mm and 0.05 degrees, and the points' number within 0.1 %."""
    (stamps, a), (others, b) = (read_spatial_tum(folder / STABILISED_NAME)
                                for folder in (offline, online))
    np.testing.assert_array_equal(stamps, others)
    assert np.abs(a[:, :3] - b[:, :3]).max() < 0.005
    assert np.rad2deg(np.abs(geometry.wrap_angle(a[:, 3:] - b[:, 3:])).max()) < 0.05
    assert np.rad2deg(np.abs(a[:, 3:5]).max(axis=0)).min() > 0.05     # it has an attitude
    a, b = (read_tum(folder / 'trajectory.tum') for folder in (offline, online))
    np.testing.assert_array_equal(a.stamps_ns, b.stamps_ns)
    difference = geometry.compose(geometry.inverse(a.poses), b.poses)
    assert np.hypot(difference[:, 0], difference[:, 1]).max() < 0.005
    assert np.rad2deg(np.abs(geometry.wrap_angle(difference[:, 2])).max()) < 0.05
    points = count_points(offline / 'facade.ply')
    assert points > 0
    assert count_points(online / 'facade.ply') == pytest.approx(points, rel=0.001)


def assert_complete(folder: Path) -> dict[str, object]:
    """Require a results folder whose files agree with one another; return its summary."""
    summary = read_summary(folder)
    assert live.line_count(folder / 'trajectory.tum') == summary['poses'] > 0
    assert live.line_count(folder / 'velocity.csv') == summary['poses'] + 1
    assert count_points(folder / 'facade.ply') == summary['points'] > 0
    assert (folder / 'facade.laz').is_file()
    assert (folder / 'report.html').is_file()
    return summary


def test_a_bag_as_fast_as_the_nodes_take_it_gives_the_offline_result(short_bag, tmp_path):
    offline = live.map_offline(short_bag, tmp_path / 'offline')
    code, output = live.shown(['run', '--bag', short_bag, '--rate', 0, '--output',
                               tmp_path / 'live'], live.environment())
    assert code == 0, output
    assert_same(offline, tmp_path / 'live')
    summary = assert_complete(tmp_path / 'live')
    assert summary['complete'] is True
    assert summary['lost_scans'] == 0
    assert [s['name'] for s in summary['scanners']] == [
        'horizontal', 'vertical_fore', 'vertical_side', 'vertical_aft']
    assert 'Traceback' not in output
    assert 'stri_estimator | ' in output
    assert '/ground_truth/odom,' in output
    assert ' /odom' not in output


@pytest.mark.realtime
def test_the_whole_drive_at_its_own_pace_gives_the_offline_result(tmp_path):
    offline = live.map_offline(live.CAMPUS, tmp_path / 'offline')
    code, output = live.shown(['run', '--bag', live.CAMPUS, '--output', tmp_path / 'live'],
                              live.environment())
    assert code == 0, output
    assert_same(offline, tmp_path / 'live')
    summary = assert_complete(tmp_path / 'live')
    assert summary['lost_scans'] == summary['malformed_scans'] == 0
    a, b = (np.concatenate(list(read_ply(folder / 'facade.ply')))
            for folder in (offline, tmp_path / 'live'))
    a, b = (np.sort(rows, order=['time', 'ring', 'z']) for rows in (a, b))
    if len(a) == len(b):                # same rays: then also the same points, to the same 5 mm
        assert max(np.abs(a[axis] - b[axis]).max() for axis in 'xyz') < 0.01


@pytest.mark.parametrize('signal_number', [2, 15])
def test_one_signal_ends_the_run_with_complete_results_and_no_process(signal_number, tmp_path):
    env = live.environment()
    with live.command('run', '--bag', live.CAMPUS, '--output', tmp_path / 'out',
                      env=env) as process:
        # poses written means points follow: the aligner has them before the file has
        live.wait_until(lambda: live.line_count(tmp_path / 'out/trajectory.tum') > 150
                        and (tmp_path / 'out/facade.ply').is_file(), 'points')
        nodes = live.node_pids(process.pid)
        assert len(nodes) >= 3              # and maybe spares
        process.send_signal(signal_number)
        output, _ = process.communicate(timeout=live.TIMEOUT)
        assert process.returncode == 130, output
        assert live.node_pids(process.pid) == []
    summary = assert_complete(tmp_path / 'out')
    assert summary['complete'] is False
    assert 'interrupted' in summary['messages']
    # what reached the estimator has a pose: nothing was thrown away at the end
    assert summary['poses'] == summary['scans']
    assert 'Traceback' not in output


def test_a_second_signal_ends_everything_at_once(tmp_path):
    with live.command('run', '--bag', live.CAMPUS, '--output', tmp_path / 'out',
                      env=live.environment()) as process:
        live.wait_until(lambda: live.line_count(tmp_path / 'out/trajectory.tum') > 1, 'poses')
        # a player that is stopped cannot answer the first signal
        player = live.node_pid(process.pid, 'bag_player')
        os.kill(player, 19)
        live.wait_until(lambda: status(player, 'State').startswith('T'), 'its stop')
        process.send_signal(2)
        live.wait_until(lambda: int(status(player, 'ShdPnd'), 16) & (1 << (2 - 1)),
                        'the first signal')
        process.send_signal(2)
        output, _ = process.communicate(timeout=live.TIMEOUT)
        assert process.returncode == 130, output
        assert live.node_pids(process.pid) == []
    assert live.line_count(tmp_path / 'out/trajectory.tum') > 1


def status(pid: int, field: str) -> str:
    """Return a field of a process's status; ShdPnd are the signals that wait for it."""
    lines = Path(f'/proc/{pid}/status').read_text(encoding='ascii').splitlines()
    return next(line.split(':', 1)[1].strip() for line in lines if line.startswith(field + ':'))


def test_nodes_do_not_outlive_a_killed_supervisor(tmp_path):
    with live.command('run', '--bag', live.CAMPUS, '--output', tmp_path / 'out',
                      env=live.environment()) as process:
        live.wait_until(lambda: live.line_count(tmp_path / 'out/trajectory.tum') > 150, 'poses')
        assert len(live.node_pids(process.pid)) >= 3
        process.kill()
        process.wait()
        live.wait_until(lambda: not live.node_pids(process.pid), 'the end of the nodes')
    # they ended as by Ctrl-C: with their results
    assert (tmp_path / 'out/facade.laz').is_file()
    assert (tmp_path / 'out/range_image.npz').is_file()
    assert (tmp_path / 'out/summary.json').is_file()


@pytest.mark.parametrize('change, code, said', [
    (['--bag', 'nowhere'], 1, 'nowhere: no such file or directory'),
    (['--vehicle', 'nowhere.yaml'], 1, 'nowhere.yaml: No such file'),
    (['--output', '{full}'], 2, 'not empty'),
])
def test_what_cannot_work_is_said_in_one_line_before_anything_starts(
        change, code, said, short_bag, tmp_path):
    (tmp_path / 'full').mkdir()
    (tmp_path / 'full/mine.txt').touch()
    change = [part.format(full=tmp_path / 'full') for part in change]
    got, output = live.shown(['run', '--bag', short_bag, '--output', tmp_path / 'out', *change],
                             live.environment())
    assert got == code
    assert output.count('\n') == 1
    assert said in output
