# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Faulty input: one line that says what is wrong, or a counted warning; never a traceback."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import shutil
import subprocess
import sys
from typing import Any

from live import CAMPUS
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from stri_mapping.bag_io import Bag
from stri_mapping.cli import main
from stri_mapping.summary import read_summary
from stri_mapping.trajectory import read_tum, Trajectory
from stri_mapping.vehicle import default_vehicle_file

STORE = get_typestore(Stores.ROS2_JAZZY)
START_NS, TURN_NS = 1_767_225_600_000_000_000, 13_320_000


def laser_scan(stamp_ns: int, ranges: Any, **fields: Any) -> Any:
    """Return a LaserScan of a scanner 1 degree fine; `fields` replace what is right."""
    types = STORE.types
    stamp = types['builtin_interfaces/msg/Time'](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = types['std_msgs/msg/Header'](stamp=stamp, frame_id='horizontal_laser')
    step = float(np.deg2rad(1.0))
    return types['sensor_msgs/msg/LaserScan'](**{
        'header': header, 'angle_min': -0.5 * np.pi, 'angle_max': 0.5 * np.pi,
        'angle_increment': step, 'time_increment': TURN_NS * 1e-9 / 360.0,
        'scan_time': TURN_NS * 1e-9, 'range_min': 0.0, 'range_max': 80.0,
        'ranges': np.asarray(ranges, dtype=np.float32),
        'intensities': np.empty(0, dtype=np.float32), **fields})


def write_bag(path: Path, messages: list[Any], topic: str = '/horizontal/scan') -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        if not messages:
            return path
        kind = messages[0].__msgtype__
        connection = writer.add_connection(topic, kind, typestore=STORE)
        for i, message in enumerate(messages):
            writer.write(connection, START_NS + i * TURN_NS, STORE.serialize_cdr(message, kind))
    return path


def good_scans(count: int) -> list[Any]:
    return [laser_scan(START_NS + i * TURN_NS, np.full(181, 5.0)) for i in range(count)]


@pytest.fixture
def fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return a function that runs a command, checks its one-line error and returns it."""
    def run(code: int, command: str, *arguments: object) -> str:
        extra = ['--output', str(tmp_path / 'out')] if command == 'map' else []
        assert main([command, *map(str, arguments), *extra]) == code
        captured = capsys.readouterr()
        assert 'Traceback' not in captured.out + captured.err
        lines = [x for x in captured.err.splitlines() if x.startswith('stri-mapping')]
        assert len(lines) == 1 and lines[0].startswith(f'stri-mapping {command}: ')
        return lines[0]
    return run


Fails = Callable[..., str]


def test_a_missing_bag(fails: Fails, tmp_path: Path) -> None:
    assert 'no such file' in fails(1, 'map', tmp_path / 'nothing')
    assert not (tmp_path / 'out').exists()               # nothing is begun for a faulty input


def test_a_folder_that_is_no_bag(fails: Fails, tmp_path: Path) -> None:
    assert 'holds no metadata.yaml' in fails(1, 'map', tmp_path)


def test_a_file_that_is_no_bag(fails: Fails, tmp_path: Path) -> None:
    for name, content in (('a.mcap', b''), ('b.mcap', b'not an mcap'), ('c.bag', b'#ROSBAG'),
                          ('d.txt', b'text')):
        (tmp_path / name).write_bytes(content)
        assert name in fails(1, 'map', tmp_path / name)


@pytest.mark.skipif(not CAMPUS.is_dir(), reason=f'{CAMPUS} is not there')
def test_a_truncated_recording_through_the_real_command(tmp_path: Path) -> None:
    cut = tmp_path / 'cut'
    shutil.copytree(CAMPUS, cut)
    content = (cut / 'campus.mcap').read_bytes()
    (cut / 'campus.mcap').write_bytes(content[:len(content) // 3])
    done = subprocess.run(
        [sys.executable, '-m', 'stri_mapping.cli', 'map', cut, '--output', tmp_path / 'out'],
        capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stdout == ''
    line, = done.stderr.splitlines()
    assert line.startswith(f'stri-mapping map: {cut}: ') and 'stri-mapping repair' in line


def test_broken_metadata(fails: Fails, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', good_scans(3))
    (bag / 'metadata.yaml').write_text('rosbag2_bagfile_information: [')
    assert str(bag) in fails(1, 'map', bag)


def test_a_bag_without_scans_lists_its_topics(fails: Fails, tmp_path: Path) -> None:
    zero = STORE.types['std_msgs/msg/String'](data='no scan')
    bag = write_bag(tmp_path / 'bag', [zero], '/chatter')
    error = fails(1, 'map', bag)
    assert 'holds no sensor_msgs/msg/LaserScan' in error and '/chatter' in error
    assert 'LaserScan' in fails(1, 'map', write_bag(tmp_path / 'empty', []))


def test_an_unknown_topic_lists_those_there_are(fails: Fails, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', good_scans(3))
    for option in ('--horizontal', '--vertical'):
        error = fails(1, 'map', bag, option, '/front/scan')
        assert '/front/scan' in error and '/horizontal/scan' in error


def test_a_topic_of_another_type(fails: Fails, tmp_path: Path) -> None:
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, message in (('/horizontal/scan', laser_scan(START_NS, [1.0])),
                               ('/text', STORE.types['std_msgs/msg/String'](data=''))):
            kind = message.__msgtype__
            writer.write(writer.add_connection(topic, kind, typestore=STORE), START_NS,
                         STORE.serialize_cdr(message, kind))
    error = fails(1, 'map', tmp_path / 'bag', '--horizontal', '/text')
    assert 'std_msgs/msg/String, want sensor_msgs/msg/LaserScan' in error


@pytest.mark.parametrize(('old', 'new', 'complaint'), [
    ('rpy:', 'ypr:', "unknown key 'ypr'"),
    ('rpy: [0.0, 0.0, 1.5707963267948966]', 'rpy: [0, 0, 90]', 'is it in radians'),
    ('xyz: [0.0, 0.6, 1.2]', 'xyz: [0, 600, 1200]', 'is it in metres'),
    ('xyz: [0.0, 0.6, 1.2]', 'xyz: [0, 0.6]', 'three numbers in metres'),
    ('role: horizontal', 'role: vertical', 'exactly one'),
    ('scanners:', 'scanners: {', 'not YAML'),
], ids=['key', 'degrees', 'millimetres', 'two numbers', 'no horizontal', 'syntax'])
def test_a_faulty_vehicle_file(fails: Fails, tmp_path: Path, old: str, new: str,
                               complaint: str) -> None:
    bag = write_bag(tmp_path / 'bag', good_scans(3))
    text = default_vehicle_file().read_text()
    assert old in text
    (tmp_path / 'mine.yaml').write_text(text.replace(old, new, 1))
    error = fails(1, 'map', bag, '--vehicle', tmp_path / 'mine.yaml')
    assert 'mine.yaml' in error and complaint in error
    assert 'none.yaml' in fails(1, 'map', bag, '--vehicle', tmp_path / 'none.yaml')


def test_an_output_folder_in_use(fails: Fails, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / 'bag', good_scans(3))
    (tmp_path / 'out').mkdir()
    (tmp_path / 'out' / 'thesis.tex').write_text('precious')
    assert '--overwrite' in fails(2, 'map', bag)
    (tmp_path / 'out' / 'thesis.tex').unlink()
    (tmp_path / 'out').rmdir()
    (tmp_path / 'out').write_text('a file')
    assert f'{tmp_path / "out"}' in fails(2, 'map', bag)


@pytest.mark.parametrize('value', [np.inf, np.nan, -np.inf, 90.0, -1.0])
def test_scans_that_hit_nothing_give_no_motion(fails: Fails, tmp_path: Path,
                                               value: float) -> None:
    bag = write_bag(tmp_path / 'bag', [laser_scan(START_NS + i * TURN_NS, np.full(181, value))
                                       for i in range(200)])
    error = fails(1, 'map', bag)
    assert '/horizontal/scan gave no motion' in error
    summary = read_summary(tmp_path / 'out')
    assert summary['scans_without_return'] == 200 and not summary['complete']
    assert (tmp_path / 'out' / 'report.html').is_file()


def test_too_few_scans(fails: Fails, tmp_path: Path) -> None:
    assert 'gave no motion' in fails(1, 'map', write_bag(tmp_path / 'bag', good_scans(2)))


@pytest.mark.skipif(not CAMPUS.is_dir(), reason=f'{CAMPUS} is not there')
def test_faulty_scans_among_good_ones_are_counted_and_left_out(tmp_path: Path) -> None:
    with Bag(CAMPUS) as campus:
        truth = campus.odometry('/ground_truth/odom')
        scans = [message for _, (_, _, message) in zip(range(375), campus.messages(
            ['/horizontal/scan']))]
    middle, full = stamp_of(scans[180]), scans[180].ranges
    odd = [{'angle_increment': 0.0}, {'angle_min': np.nan}, {'range_max': -1.0}]
    faulty = [laser_scan(middle + 1 + i, full, **fields) for i, fields in enumerate(odd)]
    empty = [laser_scan(middle + 4 + i, ranges) for i, ranges in enumerate(
        ([], np.full(181, np.nan), np.full(181, np.inf)))]
    messages = [*scans[:181], *faulty, scans[10], scans[179], *empty, *scans[181:]]
    bag = write_bag(tmp_path / 'bag', messages)
    assert main(['map', str(bag), '--output', str(tmp_path / 'out')]) == 0
    summary = read_summary(tmp_path / 'out')
    assert (summary['scans'], summary['malformed_scans']) == (378, 3)
    assert (summary['backwards_scans'], summary['scans_without_return']) == (2, 3)
    words = ' '.join(summary['warnings'])
    for part in ('angle_increment is 0', 'angle_min is nan', 'range_max', 'stamp ran backwards'):
        assert part in words
    # the faults cost neither the end of the path nor, by more than scan matchers err, its length
    path = read_tum(tmp_path / 'out' / 'trajectory.tum')
    assert path.stamps_ns[-1] == stamp_of(scans[-1])
    driven = Trajectory(path.stamps_ns, truth.at(path.stamps_ns)).distance
    assert path.distance == pytest.approx(driven, rel=0.01)


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def test_evaluating_what_cannot_be_evaluated(fails: Fails, tmp_path: Path) -> None:
    truth, folder = tmp_path / 'truth.tum', tmp_path / 'results'
    assert 'no such results folder' in fails(1, 'evaluate', folder, '--truth', truth)
    folder.mkdir()
    assert 'trajectory.tum' in fails(1, 'evaluate', folder, '--truth', truth)
    lines = [f'{i}.000000000 {i} 0 0 0 0 0 1' for i in range(5)]
    (folder / 'trajectory.tum').write_text('\n'.join(lines))
    assert '--mount' in fails(2, 'evaluate', folder, '--truth', truth)
    mount = ('--mount', 0.0, 0.0, 0.0)
    assert 'truth.tum: no such file' in fails(1, 'evaluate', folder, '--truth', truth, *mount)
    truth.write_text('1.0 2.0 three\n')
    assert 'truth.tum:1' in fails(1, 'evaluate', folder, '--truth', truth, *mount)
    truth.write_text('100.0 0 0 0 0 0 0 1\n101.0 0 0 0 0 0 0 1\n')
    assert 'no time in common' in fails(1, 'evaluate', folder, '--truth', truth, *mount)
    assert '--window' in fails(2, 'evaluate', folder, '--truth', truth, '--window', 0)
    bag = write_bag(tmp_path / 'bag', good_scans(3))
    error = fails(1, 'evaluate', folder, '--truth', bag, *mount)
    assert '/ground_truth/odom' in error and '/horizontal/scan' in error
    assert not (folder / 'evaluation.json').exists()
