# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Tiles, further formats, elevations and quality of a cloud whose truth is known."""

from __future__ import annotations

import json
from pathlib import Path
import shutil
import subprocess
import sys

import laspy
import live
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from plyfile import PlyData
import pytest

from stri_mapping.facade.cloud_files import (
    CloudWriter,
    count_points,
    read_between,
    read_ply,
    tiles,
)
from stri_mapping.facade.elevation import column_grid, straight_pieces, write_elevations
from stri_mapping.facade.export import export
from stri_mapping.facade.finish import finish_facades
from stri_mapping.facade.points import FACADE, FacadePoints, GROUND
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.facade.quality import measure
from stri_mapping.facade.writer import FacadeWriter, STABILISED_NAME
from stri_mapping.trajectory import read_spatial_tum, spatial_tum_line, Trajectory, write_tum
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

Array = NDArray[np.float64]
T0 = 1_767_225_600_000_000_000


def points_of(xyz: Array, seconds: Array, label: int = FACADE, ring: int = 0) -> FacadePoints:
    n = len(xyz)
    return FacadePoints(xyz, np.linspace(10.0, 90.0, n).astype(np.float32),
                        T0 + np.rint(seconds * 1e9).astype(np.int64),
                        np.full(n, ring, np.uint16), np.full(n, label, np.uint8))


def path(seconds: float = 20.0, speed: float = 5.0) -> Trajectory:
    stamps = T0 + np.arange(int(seconds * 75)) * 13_333_333
    t = (stamps - T0) * 1e-9
    return Trajectory(stamps, np.column_stack([speed * t, 0 * t, 0 * t]))


def arcade(rng: np.random.Generator, n: int = 60_000) -> FacadePoints:
    """Return a wall at y = 9 for 100 m with columns 0.6 m wide every 5 m, 2 m in front."""
    x = np.sort(rng.uniform(0.0, 99.0, n))
    column = np.abs((x - 1.5) % 5.0 - 2.5) < 0.3           # middles at 4, 9, 14, ...
    y = np.where(column, 7.0, 9.0) + rng.normal(0.0, 0.01, n)
    return points_of(np.column_stack([x, y, rng.uniform(0.3, 7.0, n)]), x / 5.0)


def test_full_files_are_followed_by_the_next(tmp_path: Path) -> None:
    whole = arcade(np.random.default_rng(1), 2500)
    with CloudWriter(tmp_path, ['side'], tile=1000) as writer:
        for cut in np.array_split(np.arange(2500), 7):
            writer.write(FacadePoints(*(getattr(whole, f)[cut] for f in (
                'xyz', 'intensity', 'stamps_ns', 'ring', 'label'))))
    names = [p.name for p in tiles(tmp_path / 'facade.ply')]
    assert names == ['facade.ply', 'facade_2.ply', 'facade_3.ply']
    assert [len(PlyData.read(p)['vertex'].data) for p in tiles(tmp_path / 'facade.ply')] == [
        1000, 1000, 500]
    assert count_points(tmp_path / 'facade.ply') == 2500
    rows = np.concatenate(list(read_ply(tmp_path / 'facade.ply')))
    np.testing.assert_array_equal(rows['x'], whole.xyz[:, 0])
    np.testing.assert_array_equal(rows['classification'], whole.label)
    parts = [laspy.read(p) for p in tiles(tmp_path / 'facade.laz')]
    assert [len(p.points) for p in parts] == [1000, 1000, 500]
    np.testing.assert_allclose(np.concatenate([p.xyz for p in parts]), whole.xyz, atol=0.0006)
    assert not list(tmp_path.glob('*.part'))
    # a shorter run into the same folder leaves nothing of the longer one
    with CloudWriter(tmp_path) as writer:
        writer.write(points_of(np.zeros((5, 3)), np.zeros(5)))
    assert sorted(p.name for p in tmp_path.iterdir()) == ['facade.laz', 'facade.ply']


KILLED = """
import os, sys
from pathlib import Path
import numpy as np
from stri_mapping.facade.cloud_files import CloudWriter
from stri_mapping.facade.points import FacadePoints
n = 2500
writer = CloudWriter(Path(sys.argv[1]), ['side'], tile=1000)
writer.write(FacadePoints(np.arange(3.0 * n).reshape(n, 3), np.ones(n, np.float32),
                          np.arange(n), np.zeros(n, np.uint16), np.full(n, 6, np.uint8)))
print('written', flush=True)
sys.stdin.readline()
"""


def test_a_killed_process_leaves_all_its_points_and_the_finished_files(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, '-c', KILLED, str(tmp_path)], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == 'written\n'
        live.wait_until((tmp_path / 'facade_2.laz').is_file, 'the second file')
        process.kill()
    assert count_points(tmp_path / 'facade.ply') == 2500
    finished = [laspy.read(p) for p in tiles(tmp_path / 'facade.laz')]
    assert [len(p.points) for p in finished] == [1000, 1000]
    # who goes on keeps them, and makes what is missing
    (tmp_path / 'facade_2.laz').unlink()
    before = (tmp_path / 'facade.laz').stat().st_mtime_ns
    CloudWriter(tmp_path, ['side'], tile=1000, append=True).close()
    assert (tmp_path / 'facade.laz').stat().st_mtime_ns == before
    assert [len(laspy.read(p).points) for p in tiles(tmp_path / 'facade.laz')] == [
        1000, 1000, 500]


def test_a_cloud_goes_on_after_a_crash(tmp_path: Path) -> None:
    whole = arcade(np.random.default_rng(1), 2500)
    parts = [FacadePoints(*(getattr(whole, f)[cut] for f in (
        'xyz', 'intensity', 'stamps_ns', 'ring', 'label'))) for cut in np.array_split(
            np.arange(2500), 5)]
    first = CloudWriter(tmp_path, ['side'], tile=900)
    for part in parts[:3]:
        first.write(part)
    live.wait_until((tmp_path / 'facade.laz').is_file, 'the finished file')
    with (tmp_path / 'facade_2.ply').open('ab') as file:
        file.write(b'half a rec')                  # died while it wrote
    with CloudWriter(tmp_path, ['side'], tile=900, append=True) as second:
        for part in parts[3:]:
            second.write(part)
    rows = np.concatenate(list(read_ply(tmp_path / 'facade.ply')))
    np.testing.assert_array_equal(rows['z'], whole.xyz[:, 2])
    assert len(tiles(tmp_path / 'facade.ply')) == 3
    assert [laspy.read(p).header.point_count for p in tiles(tmp_path / 'facade.laz')] == [
        900, 900, 700]


def test_a_stretch_of_time_is_read_without_the_rest(tmp_path: Path) -> None:
    whole = arcade(np.random.default_rng(1), 30_000)
    with CloudWriter(tmp_path, tile=11_000) as writer:
        writer.write(whole)
    seconds = (whole.stamps_ns - T0) * 1e-9
    rows = read_between(tmp_path / 'facade.ply', T0 * 1e-9 + 7.0, T0 * 1e-9 + 9.5)
    assert len(rows) == np.count_nonzero((seconds >= 7.0) & (seconds <= 9.5)) > 1000
    assert len(read_between(tmp_path / 'facade.ply', 0.0, 1.0)) == 0


def test_independent_readers_open_the_other_formats(tmp_path: Path) -> None:
    whole = arcade(np.random.default_rng(1), 3000)
    other = points_of(whole.xyz[:50] + 1.0, np.arange(50) * 0.01, GROUND, ring=2)
    with CloudWriter(tmp_path) as writer:
        writer.write(whole)
        writer.write(other)
    pypcd4 = pytest.importorskip('pypcd4')
    (pcd,) = export(tmp_path, 'pcd')
    cloud = pypcd4.PointCloud.from_path(pcd)
    assert cloud.points == 3050
    np.testing.assert_allclose(cloud.numpy(('x', 'y', 'z'))[:3000], whole.xyz, atol=1e-5)
    header = pcd.read_bytes()[:400].decode('ascii', 'replace')
    assert 'FIELDS x y z intensity time ring classification' in header
    assert 'SIZE 4 4 4 4 8 2 1' in header          # PCL takes float32 coordinates alone
    pye57 = pytest.importorskip('pye57')
    (name,) = export(tmp_path, 'e57')
    file = pye57.E57(str(name))
    assert file.scan_count == 2
    scan = file.read_scan_raw(0)
    np.testing.assert_allclose(np.column_stack([scan[f'cartesian{c}'] for c in 'XYZ']),
                               whole.xyz, atol=1e-9)
    np.testing.assert_allclose(scan['intensity'], whole.intensity)
    file.close()
    assert export(tmp_path / 'none', 'pcd') == []


def test_open3d_reads_ply_and_pcd(tmp_path: Path) -> None:
    open3d = pytest.importorskip('open3d', reason='open3d is not installed, or lacks a library',
                                 exc_type=ImportError)
    whole = arcade(np.random.default_rng(1), 3000)
    with CloudWriter(tmp_path, ['side']) as writer:
        writer.write(whole)
    read = open3d.io.read_point_cloud(str(tmp_path / 'facade.ply'))
    np.testing.assert_array_equal(np.asarray(read.points), whole.xyz)
    table = open3d.t.io.read_point_cloud(str(tmp_path / 'facade.ply')).point
    np.testing.assert_array_equal(table['classification'].numpy().ravel(), whole.label)
    np.testing.assert_array_equal(table['intensity'].numpy().ravel(), whole.intensity)
    pytest.importorskip('pypcd4')
    (pcd,) = export(tmp_path, 'pcd')
    read = open3d.io.read_point_cloud(str(pcd))
    np.testing.assert_allclose(np.asarray(read.points), whole.xyz, atol=1e-5)


@pytest.mark.skipif(shutil.which('pdal') is None, reason='pdal is not installed')
def test_pdal_reads_the_laz(tmp_path: Path) -> None:
    with CloudWriter(tmp_path) as writer:
        writer.write(arcade(np.random.default_rng(1), 3000))
    done = subprocess.run(['pdal', 'info', '--stats', tmp_path / 'facade.laz'],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = {s['name']: s for s in json.loads(done.stdout)['stats']['statistic']}
    assert found['X']['count'] == 3000
    assert found['Classification']['minimum'] == found['Classification']['maximum'] == FACADE
    assert found['GpsTime']['minimum'] == pytest.approx(T0 * 1e-9, abs=0.1)


def write_folder(folder: Path, points: FacadePoints) -> None:
    with CloudWriter(folder) as writer:
        writer.write(points)
    write_tum(folder / 'trajectory.tum', path())
    (folder / STABILISED_NAME).write_text(''.join(
        spatial_tum_line(int(s), [*p[:2], 0.0, 0.0, 0.0, p[2]]) + '\n'
        for s, p in zip(path().stamps_ns, path().poses)), encoding='utf-8')


def test_elevations_show_columns_where_the_world_file_says(tmp_path: Path) -> None:
    write_folder(tmp_path, arcade(np.random.default_rng(4)))
    facts = finish_facades(tmp_path)
    (entry,) = facts['elevations']
    assert entry['files'] == [f'facade_elevation_1_{kind}.png' for kind in ('depth', 'intensity')]
    plane = entry['plane']
    assert plane['origin'][1] == pytest.approx(9.0, abs=0.05)
    assert plane['heading_deg'] == pytest.approx(0.0, abs=0.1)
    assert plane['grid_is_period'] and plane['grid_m'] == pytest.approx(5.0, abs=0.05)
    picture = np.asarray(Image.open(tmp_path / entry['files'][0])).astype(float)
    a, _, _, e, c, f = (float(line) for line in (
        tmp_path / 'facade_elevation_1_depth.pgw').read_text().split())
    assert e == -a < 0.0
    row = int((3.0 - f) / e)                       # 3 m above the ground
    place = c + a * np.arange(picture.shape[1])    # by the world file: metres along the plane
    middles = np.abs((place - 1.5) % 5.0 - 2.5) < 0.15
    between = np.abs((place - 1.5) % 5.0 - 2.5) > 0.6
    near, far = picture[row][middles & (place < 98)], picture[row][between & (place < 98)]
    # columns are yellow, the wall is violet; the grid's own lines lie on the columns
    assert np.median(near[:, 0]) > np.median(far[:, 0]) + 80.0
    assert len(list(tmp_path.glob('facade_elevation_*'))) == 4
    assert write_elevations(tmp_path, path(1.0)) == []   # too short: no picture, old ones gone
    assert len(list(tmp_path.glob('facade_elevation_*'))) == 0


def test_no_cloud_gives_no_pictures_and_no_figures(tmp_path: Path) -> None:
    assert finish_facades(tmp_path) == {}


def test_a_path_is_cut_where_it_bends() -> None:
    stamps = T0 + np.arange(2001) * 10_000_000
    yaw = np.clip((np.arange(2001) - 900) / 200.0, 0.0, 1.0) * np.pi / 2
    step = 0.05 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    corner = Trajectory(stamps, np.column_stack([np.cumsum(step, axis=0), yaw]))
    pieces = straight_pieces(corner)
    for first, last in pieces:
        assert np.ptp(yaw[first:last]) < np.deg2rad(9.0)
    assert sum(last - first for first, last in pieces) > 1500


def test_a_plain_wall_has_no_period() -> None:
    rng = np.random.default_rng(5)
    along, behind, up = rng.uniform(0, 100, 20_000), rng.normal(0, 0.01, 20_000), rng.uniform(
        0, 8, 20_000)
    assert column_grid(along, behind, up) is None


@pytest.mark.parametrize('gap_mm', [0.0, 15.0, 60.0])
def test_quality_finds_how_far_two_scanners_are_apart(gap_mm: float) -> None:
    rng = np.random.default_rng(6)
    x, z = rng.uniform(0.0, 30.0, 60_000), rng.uniform(0.0, 8.0, 60_000)
    ring = rng.integers(0, 2, 60_000).astype(np.uint16)
    y = 9.1 + 1e-3 * gap_mm * ring + rng.normal(0.0, 0.01, 60_000)
    got = measure(np.column_stack([x, y, z]), ring)
    # two planes g apart lie g / 2 from their common one; the noise of some 20 points each adds
    assert got.agreement_mm == pytest.approx(0.5 * gap_mm, abs=2.0)
    assert got.thickness_mm == pytest.approx(np.hypot(10.0, 0.5 * gap_mm), abs=1.5)
    assert got.doubled == pytest.approx(float(gap_mm > 40.0), abs=0.02)
    assert got.lean_deg < 0.3
    assert got.cubes > 500


def test_quality_sees_a_wall_lean_and_leaves_the_road_out() -> None:
    rng = np.random.default_rng(7)
    x, z = rng.uniform(0.0, 30.0, 60_000), rng.uniform(0.0, 8.0, 60_000)
    ring = rng.integers(0, 3, 60_000).astype(np.uint16)
    wall = np.column_stack([x, 9.1 + np.tan(np.deg2rad(1.0)) * z, z])
    assert measure(wall + rng.normal(0, 0.005, wall.shape), ring).lean_deg == pytest.approx(
        1.0, abs=0.15)
    road = measure(np.column_stack([x, z, 0.01 * rng.normal(size=60_000)]), ring)
    assert road.cubes == 0 and np.isnan(road.thickness_mm)
    assert measure(np.empty((0, 3)), np.empty(0, np.uint16)).cubes == 0


def test_spatial_poses_come_back_from_their_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    poses = rng.normal(size=(50, 6)) * [50.0, 50.0, 0.1, 0.02, 0.02, 0.5]
    stamps = T0 + np.arange(50) * 13_320_007
    (tmp_path / 'a.tum').write_text(''.join(
        spatial_tum_line(int(s), p) + '\n' for s, p in zip(stamps, poses)), encoding='utf-8')
    got_stamps, got = read_spatial_tum(tmp_path / 'a.tum')
    np.testing.assert_array_equal(got_stamps, stamps)
    np.testing.assert_allclose(got, poses, atol=1e-8)


def test_stabilised_poses_are_written_once_though_the_path_comes_again(tmp_path: Path) -> None:
    scanners = load_vehicle(default_vehicle_file()).verticals
    for until, append in ((400, False), (700, True)):
        aligner = FacadeAligner(scanners)
        writer = FacadeWriter(tmp_path, [s.name for s in scanners], append)
        aligner.add_poses(path().stamps_ns[:until], path().poses[:until])
        writer.take(aligner)
        aligner.finish()
        writer.take(aligner)
        writer.close()
    stamps, _ = read_spatial_tum(tmp_path / STABILISED_NAME)
    np.testing.assert_array_equal(stamps, path().stamps_ns[:700])
