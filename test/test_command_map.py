# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`map` and `evaluate` on the included drive: all files, and errors against its truth."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import shutil
import signal
from typing import Any

import laspy
from live import CAMPUS, cut_bag
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from stri_mapping import geometry
from stri_mapping.bag_io import Bag
from stri_mapping.cli import main
from stri_mapping.facade.cloud_files import read_ply
from stri_mapping.mapping import Mapper
from stri_mapping.motion_file import read_velocity
from stri_mapping.summary import read_summary
from stri_mapping.trajectory import read_tum, Trajectory, write_tum

SECONDS = 10.0
FILES = {'trajectory.tum', 'trajectory_stabilised.tum', 'velocity.csv', 'facade.laz', 'facade.ply',
         'report.html', 'summary.json', 'range_image.npz'}
ELEVATION = {f'facade_elevation_1_{kind}.{end}' for kind in ('depth', 'intensity')
             for end in ('png', 'pgw')}

pytestmark = pytest.mark.skipif(not CAMPUS.is_dir(), reason=f'{CAMPUS} is not there')


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return cut_bag(CAMPUS, tmp_path_factory.mktemp('bags') / 'ten_seconds', SECONDS)


@pytest.fixture(scope='module')
def results(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('results') / 'new' / 'folder'
    assert main(['map', str(bag), '--output', str(folder)]) == 0
    return folder


@pytest.fixture(scope='module')
def truth(bag: Path) -> Trajectory:
    with Bag(bag) as reader:
        return reader.odometry('/ground_truth/odom')


def horizontal_stamps(bag: Path) -> list[int]:
    with Bag(bag) as reader:
        return [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
                for _, _, m in reader.messages(['/horizontal/scan'])]


def test_the_results_folder_is_complete_and_agrees_with_itself(bag: Path, results: Path) -> None:
    assert {p.name for p in results.iterdir()} == FILES | ELEVATION
    path, summary = read_tum(results / 'trajectory.tum'), read_summary(results)
    stamps = horizontal_stamps(bag)
    np.testing.assert_array_equal(path.stamps_ns, stamps)        # one line a horizontal scan
    np.testing.assert_array_equal(read_velocity(results / 'velocity.csv')[0], stamps)
    rows = np.concatenate(list(read_ply(results / 'facade.ply')))
    las = laspy.read(results / 'facade.laz')
    assert summary['points'] == len(rows) == las.header.point_count > 200_000
    assert summary['scans'] == summary['poses'] == len(stamps)
    assert summary['complete'] and summary['lost_scans'] == 0
    assert summary['distance_m'] == pytest.approx(path.distance, abs=0.001)
    assert summary['duration_s'] == pytest.approx(path.duration)
    # every ray of the vertical scans has become a point or is accounted for
    assert summary['points'] + summary['rays_without_return'] + summary['rays_without_pose'] == (
        181 * sum(s['scans'] for s in summary['scanners'] if s['role'] == 'vertical'))
    assert {s['name']: s.get('point_source_id') for s in summary['scanners']} == {
        'horizontal': None, 'vertical_fore': 1, 'vertical_side': 2, 'vertical_aft': 3}
    assert {'real_time_factor', 'ms_per_scan', 'degenerate_s', 'warnings',
            'footprint_pull'} <= summary.keys()


def test_columns_stand_six_metres_apart(results: Path, truth: Trajectory) -> None:
    path = read_tum(results / 'trajectory.tum')
    rows = np.concatenate(list(read_ply(results / 'facade.ply')))
    start = geometry.compose(truth.at(path.stamps_ns[:1])[0], geometry.inverse(path.poses[0]))
    planar = np.column_stack([rows['x'], rows['y'], np.zeros(len(rows))])
    x, y, _ = geometry.compose(start, planar).T
    # the fronts of the columns, 0.6 m wide at 6.6 m: scene.json beside the bag
    front = (np.abs(y - 6.3) < 0.1) & (rows['z'] > 1.0) & (rows['z'] < 6.0)
    near = front & (np.abs(x - 6.0 * np.rint(x / 6.0)) < 0.6) & (x > 3.0) & (x < 45.0)
    centres = [np.median(x[near & (np.rint(x / 6.0) == k)]) for k in range(1, 8)]
    # a scan line every 0.07 to 0.11 m from each of three scanners puts a centre within 0.03 m;
    # a speed wrong by 0.5 % would add 0.03 m to every step
    np.testing.assert_allclose(np.diff(centres), 6.0, atol=0.06)
    np.testing.assert_allclose(centres, 6.0 * np.arange(1, 8), atol=0.3)


def errors_of(results: Path, folder: Path, *arguments: object) -> dict[str, Any]:
    """Evaluate a copy of the results, their report left out, and return what was found."""
    folder.mkdir()
    for name in ('trajectory.tum', 'velocity.csv', 'summary.json'):
        shutil.copy(results / name, folder)
    assert main(['evaluate', str(folder), *map(str, arguments)]) == 0
    return dict(json.loads((folder / 'evaluation.json').read_text())['errors'])


def test_errors_against_the_truth_in_the_bag(bag: Path, results: Path, tmp_path: Path,
                                             capsys: pytest.CaptureFixture[str]) -> None:
    errors = errors_of(results, tmp_path / 'evaluated', '--truth', bag)
    # what the best scan matchers reach on such a drive (docs/method.md): 0.52 %, 0.043 m/s, 8.9 %
    assert errors['drift_percent'] < 0.52
    assert errors['velocity_rmse_mps'] < 0.043
    assert errors['speed_error_worst_percent'] < 8.9
    assert errors['standing_speed_rms_mps'] is None
    assert 'percent of the distance' in capsys.readouterr().out
    assert not (tmp_path / 'evaluated' / 'report.html').exists()


def test_errors_are_the_same_against_a_tum_file(bag: Path, results: Path, truth: Trajectory,
                                                tmp_path: Path) -> None:
    write_tum(tmp_path / 'truth.tum', truth)
    found = [errors_of(results, tmp_path / source.stem, '--truth', source, '--window', 0.4)
             for source in (bag, tmp_path / 'truth.tum')]
    assert found[0] == pytest.approx(found[1], abs=1e-5)          # 9 decimals in the text
    assert found[0]['distance_m'] > 50.0


def test_errors_against_relations_of_the_laser(results: Path, truth: Trajectory,
                                               tmp_path: Path) -> None:
    laser = geometry.compose(truth.poses, [0.0, 0.6, np.pi / 2])  # the mount in the bag
    lines = ['t1,t2,dx,dy,dyaw']
    for i in range(20, len(truth) - 300, 50):
        dx, dy, dyaw = geometry.compose(geometry.inverse(laser[i]), laser[i + 200])
        first, second = truth.stamps_ns[[i, i + 200]] * 1e-9
        lines.append(f'{first:.6f},{second:.6f},{dx:.6f},{dy:.6f},{dyaw:.6f}')
    (tmp_path / 'relations.csv').write_text('\n'.join(lines) + '\n')
    errors = errors_of(results, tmp_path / 'evaluated', '--truth', tmp_path / 'relations.csv')
    assert errors['relations_local'] == errors['relations_all'] == len(lines) - 1
    # 2 s apart, that is 10 to 16 m: half a percent, and as much heading as that
    assert errors['relations_local_mean_m'] < 0.08
    assert errors['relations_local_mean_deg'] < 0.3


def test_one_horizontal_scanner_alone_gives_motion_and_no_facade(tmp_path: Path,
                                                                 bag: Path) -> None:
    alone = rewritten(bag, tmp_path / 'bag', lambda topic, raw: raw if topic in (
        '/horizontal/scan', '/tf_static') else None)
    assert main(['map', str(alone), '--output', str(tmp_path / 'out')]) == 0
    assert {p.name for p in (tmp_path / 'out').iterdir()} == FILES - {
        'facade.laz', 'facade.ply', 'trajectory_stabilised.tum'}
    assert read_summary(tmp_path / 'out')['points'] == 0
    page = (tmp_path / 'out' / 'report.html').read_text(encoding='utf-8')
    assert '<h2>Velocity</h2>' in page and '<h2>Facade' not in page
    # facades change nothing in the motion
    np.testing.assert_array_equal(read_tum(tmp_path / 'out' / 'trajectory.tum').stamps_ns,
                                  horizontal_stamps(bag))


def rewritten(source: Path, target: Path, change: Callable[[str, bytes], bytes | None]) -> Path:
    """Copy a bag, each message as `change` returns it, None for none."""
    with Bag(source) as reader, Writer(target, version=9,
                                       storage_plugin=StoragePlugin.MCAP) as out:
        made: dict[str, Any] = {}
        for connection, log_ns, data in reader.raw_messages():
            raw = change(connection.topic, data)
            if raw is None:
                continue
            if connection.topic not in made:
                made[connection.topic] = out.add_connection(
                    connection.topic, connection.msgtype, msgdef=connection.msgdef.data,
                    rihs01=connection.digest)
            out.write(made[connection.topic], log_ns, raw)
    return target


def test_an_interrupt_keeps_what_is_done(bag: Path, tmp_path: Path,
                                         monkeypatch: pytest.MonkeyPatch) -> None:
    add, calls = Mapper.add, []

    def interrupted(self: Mapper, *args: Any) -> None:
        calls.append(1)
        if len(calls) == 1500:
            signal.raise_signal(signal.SIGINT)
        add(self, *args)

    monkeypatch.setattr(Mapper, 'add', interrupted)
    handler = signal.getsignal(signal.SIGINT)
    assert main(['map', str(bag), '--output', str(tmp_path / 'out')]) == 130
    assert signal.getsignal(signal.SIGINT) is handler
    assert len(calls) == 1500                                    # the scan at hand was finished
    check_partial(tmp_path / 'out', 'interrupted')


def test_a_bag_that_breaks_off_keeps_what_is_done(tmp_path: Path,
                                                  capsys: pytest.CaptureFixture[str]) -> None:
    broken = tmp_path / 'broken'
    broken.mkdir()
    content = bytearray((CAMPUS / 'campus.mcap').read_bytes())
    middle = len(content) // 4
    content[middle:middle + 100_000] = bytes(100_000)            # more than a chunk
    (broken / 'campus.mcap').write_bytes(content)
    (broken / 'metadata.yaml').write_bytes((CAMPUS / 'metadata.yaml').read_bytes())
    assert main(['map', str(broken), '--output', str(tmp_path / 'out')]) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith(f'stri-mapping map: {broken}: cannot be read')
    check_partial(tmp_path / 'out', 'cannot be read')


def check_partial(folder: Path, message: str) -> None:
    assert {p.name for p in folder.iterdir()} == FILES | ELEVATION
    summary = read_summary(folder)
    assert not summary['complete'] and any(message in w for w in summary['warnings'])
    assert summary['poses'] == summary['scans'] > 300 and summary['points'] > 50_000
    assert summary['rays_without_pose'] < 3 * 3 * 181            # of the scans at the very end
    assert len(read_tum(folder / 'trajectory.tum')) == summary['poses']
    assert laspy.read(folder / 'facade.laz').header.point_count == summary['points']
    assert message in (folder / 'report.html').read_text(encoding='utf-8')


def test_evaluating_renews_a_report_that_is_there(bag: Path, results: Path,
                                                  tmp_path: Path) -> None:
    folder = tmp_path / 'copy'
    shutil.copytree(results, folder, ignore=shutil.ignore_patterns('facade*', 'range*'))
    assert main(['evaluate', str(folder), '--truth', str(bag)]) == 0
    assert 'Errors against ten_seconds' in (folder / 'report.html').read_text(encoding='utf-8')
