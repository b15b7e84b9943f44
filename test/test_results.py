# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

import json
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
import laspy
import numpy as np
from plyfile import PlyData
import pytest

from stri_mapping import __version__
from stri_mapping.errors import StriMappingError, UsageError
from stri_mapping.facade.cloud_files import CloudWriter, count_points, read_ply
from stri_mapping.facade.points import FacadePoints
from stri_mapping.motion_file import MotionWriter, read_velocity, VELOCITY_HEADER
from stri_mapping.results import prepare_folder
from stri_mapping.scan import ScanCounts
from stri_mapping.stri.estimate import Estimate
from stri_mapping.summary import lost_scans, read_summary, scanner_facts, write_summary
from stri_mapping.trajectory import read_tum
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

START_NS = 1_767_225_600_123_456_789


def some_points(count: int, seed: int = 0, brightest: float = 255.0) -> FacadePoints:
    rng = np.random.default_rng(seed)
    return FacadePoints(
        rng.uniform([-300.0, -20.0, -1.0], [500.0, 40.0, 25.0], (count, 3)),
        rng.uniform(0.0, brightest, count).astype(np.float32),
        START_NS + rng.integers(0, 600 * 10**9, count),
        rng.integers(0, 3, count).astype(np.uint16),
        rng.choice([1, 2, 5, 6, 7], count).astype(np.uint8))


def estimate(index: int, degenerate: bool = False) -> Estimate:
    return Estimate(START_NS + index * 100_000_000, np.array([0.5 * index, 0.25, 0.1]),
                    np.eye(3), np.array([5.0, -0.125, 0.25]),
                    np.diag([0.01, 0.04, 0.0025]) ** 2, 0.875, degenerate)


def test_cloud_files_hold_what_was_written(tmp_path: Path) -> None:
    pieces = [some_points(1000, 1), some_points(0), some_points(2500, 2)]
    with CloudWriter(tmp_path, ['fore', 'side', 'aft']) as writer:
        for piece in pieces:
            writer.write(piece)
    xyz = np.concatenate([p.xyz for p in pieces])
    stamps = np.concatenate([p.stamps_ns for p in pieces])
    intensity = np.concatenate([p.intensity for p in pieces])
    ring = np.concatenate([p.ring for p in pieces])

    las = laspy.read(tmp_path / 'facade.laz')
    np.testing.assert_allclose(las.xyz, xyz, atol=0.0005001)    # half a step of its raster
    # seconds since 1970 as float64 are good to half of 2.4e-7 s
    np.testing.assert_allclose(las.gps_time, stamps * 1e-9, atol=2.4e-7, rtol=0.0)
    np.testing.assert_allclose(las.intensity, intensity * 257.0, atol=0.51)
    np.testing.assert_array_equal(las.point_source_id, ring + 1)
    assert set(las.return_number) == set(las.number_of_returns) == {1}
    header = las.header
    assert (str(header.version), header.point_format.id) == ('1.4', 6)
    assert header.point_count == len(xyz)
    np.testing.assert_allclose(header.mins, xyz.min(axis=0), atol=0.0006)
    np.testing.assert_allclose(header.maxs, xyz.max(axis=0), atol=0.0006)
    assert header.generating_software == f'stri_mapping {__version__}'
    assert header.global_encoding.wkt
    assert header.creation_date is not None
    text = header.vlrs.get_by_id('LASF_Spec', (3,))[0].record_data.decode()
    assert 'Unix epoch' in text and '2 side' in text and 'times 257' in text

    vertex = PlyData.read(tmp_path / 'facade.ply')['vertex']
    np.testing.assert_array_equal(np.column_stack([vertex[k] for k in 'xyz']), xyz)
    np.testing.assert_allclose(vertex['time'], stamps * 1e-9, atol=2.4e-7, rtol=0.0)
    np.testing.assert_array_equal(vertex['intensity'], intensity)
    np.testing.assert_array_equal(vertex['ring'], ring)


def test_the_laz_is_compressed(tmp_path: Path) -> None:
    with CloudWriter(tmp_path) as writer:
        writer.write(some_points(5000))
    # uncompressed, point format 6 takes 30 bytes a point; bit 7 of the format id says LAZ
    assert (tmp_path / 'facade.laz').stat().st_size < 5000 * 30
    assert (tmp_path / 'facade.laz').read_bytes()[104] & 0x80


def test_intensities_of_sixteen_bits_are_kept_as_they_are(tmp_path: Path) -> None:
    points = some_points(1000, brightest=60000.0)
    with CloudWriter(tmp_path) as writer:
        writer.write(points)
    las = laspy.read(tmp_path / 'facade.laz')
    np.testing.assert_allclose(las.intensity, points.intensity, atol=0.51)


def test_the_ply_is_complete_after_every_write(tmp_path: Path) -> None:
    writer = CloudWriter(tmp_path, ['side'])
    total = 0
    for count in (1, 8, 90, 1000):                       # the digits of the count grow
        writer.write(some_points(count, count))
        total += count
        assert len(PlyData.read(tmp_path / 'facade.ply')['vertex'].data) == total
        assert count_points(tmp_path / 'facade.ply') == total
    assert not (tmp_path / 'facade.laz').exists()        # as after a crash, here
    writer.close()
    writer.close()
    assert laspy.read(tmp_path / 'facade.laz').header.point_count == total


def test_an_exception_in_the_context_still_completes_the_cloud(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        with CloudWriter(tmp_path) as writer:
            writer.write(some_points(10))
            raise KeyboardInterrupt
    assert laspy.read(tmp_path / 'facade.laz').header.point_count == 10


def test_no_points_give_no_files_and_old_ones_go(tmp_path: Path) -> None:
    with CloudWriter(tmp_path) as writer:
        writer.write(some_points(10))
    with CloudWriter(tmp_path) as writer:
        writer.write(some_points(0))
    assert list(tmp_path.iterdir()) == []
    assert count_points(tmp_path / 'facade.ply') == 0


def test_reading_a_cloud_thinned_takes_every_nth_point(tmp_path: Path) -> None:
    points = some_points(1001)
    with CloudWriter(tmp_path) as writer:
        writer.write(points)
    rows = np.concatenate(list(read_ply(tmp_path / 'facade.ply', every=7)))
    np.testing.assert_array_equal(rows['x'], points.xyz[::7, 0])
    (tmp_path / 'other.ply').write_text('ply\nnonsense\n')
    with pytest.raises(StriMappingError, match='other.ply: not a cloud'):
        list(read_ply(tmp_path / 'other.ply'))


def test_motion_files_follow_their_formats(tmp_path: Path) -> None:
    with MotionWriter(tmp_path) as writer:
        writer.write([estimate(0), estimate(1)])
        half_way = (tmp_path / 'trajectory.tum').read_text()
        writer.write([estimate(2)])
    assert half_way.count('\n') == 2                     # nothing waits in a buffer
    first = (tmp_path / 'trajectory.tum').read_text().splitlines()[0].split()
    assert first[0] == '1767225600.123456789'
    assert all(len(value.partition('.')[2]) == 9 for value in first)
    path = read_tum(tmp_path / 'trajectory.tum')
    np.testing.assert_array_equal(path.stamps_ns, START_NS + np.arange(3) * 100_000_000)
    np.testing.assert_allclose(path.poses, [[0.5 * i, 0.25, 0.1] for i in range(3)], atol=2e-9)

    lines = (tmp_path / 'velocity.csv').read_text().splitlines()
    assert lines[0] == VELOCITY_HEADER == 'stamp,vx,vy,wz,sigma_vx,sigma_vy,sigma_wz,quality'
    stamps, values = read_velocity(tmp_path / 'velocity.csv')
    np.testing.assert_array_equal(stamps, path.stamps_ns)
    np.testing.assert_allclose(values, [[5.0, -0.125, 0.25, 0.01, 0.04, 0.0025, 0.875]] * 3)


def test_degenerate_stretches_last_until_the_motion_is_seen_again(tmp_path: Path) -> None:
    flags = [False, True, True, False, False, True, False, True]
    with MotionWriter(tmp_path) as writer:
        for index, flag in enumerate(flags):
            writer.write([estimate(index, flag)])
    facts = writer.facts()
    # 0.1 s apart: from 1 to 3, from 5 to 6, and an end that has not lasted yet
    assert facts['degenerate_s'] == pytest.approx(0.3)
    origin = START_NS * 1e-9
    np.testing.assert_allclose(np.array(facts['degenerate_stretches']) - origin,
                               [[0.1, 0.3], [0.5, 0.6], [0.7, 0.7]], atol=1e-6)


@pytest.mark.parametrize('content', ['', 'a,b\n', f'{VELOCITY_HEADER}\n1.0,x\n'])
def test_a_foreign_velocity_table_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / 'velocity.csv').write_text(content)
    with pytest.raises(StriMappingError, match='velocity.csv: want a table'):
        read_velocity(tmp_path / 'velocity.csv')


@given(st.integers(20, 60), st.sets(st.integers(1, 58), max_size=12), st.integers(0, 2**32 - 1))
@settings(max_examples=80, deadline=None)
def test_lost_scans_are_counted_exactly(count: int, gone: set[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    keep = [i for i in range(count) if i not in gone or i == count - 1]
    if np.median(np.diff(keep)) > 1.0:                   # more lost than kept: no period to see
        return
    # scanner clocks are steady to far better than a tenth of a turn
    stamps = START_NS + np.array(keep) * 13_320_000 + rng.integers(-600_000, 600_000, len(keep))
    assert lost_scans(stamps) == keep[-1] + 1 - len(keep)


def test_late_stamps_are_not_lost_scans() -> None:
    stamps = START_NS + np.arange(100) * 50_000_000
    stamps[40:44] += np.array([120, 80, 60, 20]) * 1_000_000      # a logger that fell behind
    assert lost_scans(stamps) == 0
    assert lost_scans(np.delete(stamps, [70, 71])) == 2
    irregular = np.cumsum(np.random.default_rng(0).exponential(1e8, 500)).astype(np.int64)
    assert lost_scans(irregular) == 0                    # a logger that records on events
    assert lost_scans(stamps[:2]) == 0 and lost_scans([]) == 0


def test_summary_gathers_facts_of_several_writers(tmp_path: Path) -> None:
    vehicle = load_vehicle(default_vehicle_file())
    stamps = START_NS + np.delete(np.arange(50), 7) * 13_320_000
    with MotionWriter(tmp_path) as motion:
        motion.write(estimate(i) for i in range(21))
    with CloudWriter(tmp_path) as cloud:
        cloud.write(some_points(40))
    write_summary(tmp_path, {
        'scans': 49, 'messages': ['first'],
        'scanners': [scanner_facts(vehicle, vehicle.horizontal, stamps, ScanCounts(49, 1, 2, 3))]})
    summary = write_summary(tmp_path, {
        'ms_per_scan': 1.0, 'messages': ['second'],
        'scanners': [scanner_facts(vehicle, vehicle.verticals[1], stamps, ScanCounts(49))]})
    assert summary == read_summary(tmp_path) == json.loads(
        (tmp_path / 'summary.json').read_text())
    assert (summary['scans'], summary['points'], summary['ms_per_scan']) == (49, 40, 1.0)
    assert (summary['distance_m'], summary['duration_s']) == (10.0, 2.0)
    assert summary['mean_speed_mps'] == pytest.approx(np.hypot(5.0, 0.125), abs=1e-4)
    assert (summary['lost_scans'], summary['malformed_scans']) == (2, 1)
    assert [s['name'] for s in summary['scanners']] == ['horizontal', 'vertical_side']
    assert summary['scanners'][1]['point_source_id'] == 2
    assert summary['scanners'][0]['mount']['rpy'] == pytest.approx([0.0, 0.0, np.pi / 2])
    assert summary['warnings'][:2] == ['first', 'second']
    assert 'horizontal: 1 scans are missing beside 49 good ones' in summary['warnings']


def test_a_summary_that_is_no_json_object_is_refused(tmp_path: Path) -> None:
    assert read_summary(tmp_path) == {}
    for content in ('[1]', '{', ''):
        (tmp_path / 'summary.json').write_text(content)
        with pytest.raises(StriMappingError, match='summary.json: want a JSON object'):
            read_summary(tmp_path)


def test_a_results_folder_is_never_overwritten_by_accident(tmp_path: Path) -> None:
    folder = tmp_path / 'a' / 'b'
    prepare_folder(folder)
    prepare_folder(folder)                               # still empty
    (folder / 'facade.laz').write_text('precious')
    (folder / 'notes.txt').write_text('mine')
    with pytest.raises(UsageError, match='not empty.*--overwrite'):
        prepare_folder(folder)
    assert (folder / 'facade.laz').read_text() == 'precious'
    prepare_folder(folder, overwrite=True)
    assert [p.name for p in folder.iterdir()] == ['notes.txt']
    with pytest.raises(UsageError, match=r'notes\.txt'):
        prepare_folder(folder / 'notes.txt')
