# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

import json
from pathlib import Path
import re

import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.errors import StriMappingError
from stri_mapping.facade.cloud_files import CloudWriter
from stri_mapping.facade.pictures import blended, Grid, nearest_depth, unroll
from stri_mapping.facade.points import FACADE, FacadePoints, GROUND
from stri_mapping.motion_file import MotionWriter
from stri_mapping.report import write_report
from stri_mapping.report.data import read_folder
from stri_mapping.report.facade_figures import facade_views
from stri_mapping.stri.estimate import Estimate
from stri_mapping.summary import write_summary
from stri_mapping.trajectory import Trajectory

START_NS = 1_767_225_600_000_000_000
SECTIONS = ('Path', 'Facade on the left', 'Before and after alignment', 'Velocity',
            'Range image', 'Quality')


def write_motion(folder: Path, yaw_rate: float = 0.0) -> Trajectory:
    seconds = np.arange(0.0, 12.0, 0.05)
    stamps = START_NS + np.round(seconds * 1e9).astype(np.int64)
    twists = np.array([5.0, 0.0, yaw_rate]) * seconds[:, None]
    path = Trajectory(stamps, geometry.exp(twists))
    with MotionWriter(folder) as motion:
        motion.write(Estimate(int(s), p, np.eye(3), np.array([5.0, 0.0, yaw_rate]),
                              1e-4 * np.eye(3), 0.9, 40 < i < 60)
                     for i, (s, p) in enumerate(zip(stamps, path.poses)))
    write_summary(folder, {'source': 'street/bag', **motion.facts(), 'scanners': [
        {'name': 'horizontal', 'role': 'horizontal', 'topic': '/scan', 'scans': 240,
         'lost_scans': 3, 'malformed_scans': 0, 'backwards_scans': 0,
         'scans_without_return': 0, 'mount': {'xyz': [0.0, 0.6, 1.2], 'rpy': [0.0, 0.0, 1.57]}}],
        'messages': ['<b>sharp & odd</b>']})
    return path


def write_cloud(folder: Path, path: Trajectory, side: float = 1.0) -> None:
    """Write a wall 8 m beside the path with ground before it."""
    rng = np.random.default_rng(1)
    stamps = rng.integers(path.stamps_ns[0], path.stamps_ns[-1], 20_000)
    wall = rng.random(20_000) < 0.7
    across = side * np.where(wall, 8.0, rng.uniform(2.0, 8.0, 20_000))
    up = np.where(wall, rng.uniform(0.0, 7.0, 20_000), 0.0)
    place = geometry.compose(path.at(stamps), np.column_stack([0 * across, across, 0 * across]))
    with CloudWriter(folder, ['side']) as cloud:
        cloud.write(FacadePoints(np.column_stack([place[:, :2], up]),
                                 rng.uniform(0, 255, 20_000).astype(np.float32), stamps,
                                 np.zeros(20_000, np.uint16),
                                 np.where(wall, FACADE, GROUND).astype(np.uint8)))


def write_range_image(folder: Path) -> None:
    ranges = np.random.default_rng(2).uniform(2.0, 9.0, (200, 60)).astype(np.float32)
    ranges[:, 50:] = np.nan
    np.savez(folder / 'range_image.npz', stamps_ns=START_NS + np.arange(200) * 60_000_000,
             bearings=np.deg2rad(np.arange(60.0)), ranges=ranges,
             segments=np.where(np.isnan(ranges), -1, 3).astype(np.int32))


def sections(page: str) -> list[str]:
    return re.findall('<h2>(.*?)</h2>', page)


@pytest.fixture
def full(tmp_path: Path) -> Path:
    write_cloud(tmp_path, write_motion(tmp_path))
    write_range_image(tmp_path)
    write_summary(tmp_path, {})
    return tmp_path


def test_the_page_is_complete_self_contained_and_small(full: Path) -> None:
    page = write_report(full).read_text(encoding='utf-8')
    assert [s for s in sections(page) if s in SECTIONS] == list(SECTIONS)
    assert not re.search(r'(src|href)\s*=\s*"(?!data:)', page)
    assert '<script' not in page and 'url(' not in page and '@import' not in page
    assert len(page) < 5_000_000
    for figure in ('59.8 m', '11.9 s', '5.00 m/s', '1.0 s', '20,000'):
        assert figure in page
    assert 'horizontal: 3 scans are missing beside 240 good ones' in page
    assert '&lt;b&gt;sharp &amp; odd&lt;/b&gt;' in page and '<b>sharp' not in page


def test_the_page_is_a_function_of_the_folder(full: Path) -> None:
    first = write_report(full).read_bytes()
    assert write_report(full).read_bytes() == first
    assert not list(full.glob('*.part'))


def test_errors_against_the_truth_appear_once_evaluated(full: Path) -> None:
    metric = {'name': 'drift_percent', 'value': 0.4321, 'unit': '%', 'text': 'drift at the end'}
    none = {'name': 'x', 'value': None, 'unit': 'm', 'text': 'no case'}
    (full / 'evaluation.json').write_text(json.dumps(
        {'truth': 'a/truth.tum', 'metrics': [metric, none]}))
    page = write_report(full).read_text(encoding='utf-8')
    assert 'Errors against truth.tum' in page
    assert 'drift at the end' in page and '0.4321' in page and 'no case' in page


@pytest.mark.parametrize(('missing', 'sections_gone'), [
    ('facade.ply', {'Facade on the left', 'Before and after alignment'}),
    ('range_image.npz', {'Range image'}),
    ('velocity.csv', {'Velocity'}),
    ('trajectory.tum', {'Path', 'Facade on the left', 'Before and after alignment'}),
    ('summary.json', {'Quality'}),
])
def test_a_missing_part_is_left_out(full: Path, missing: str, sections_gone: set[str]) -> None:
    (full / missing).unlink()
    page = write_report(full).read_text(encoding='utf-8')
    assert [s for s in sections(page) if s in SECTIONS] == [
        s for s in SECTIONS if s not in sections_gone]


def test_an_empty_folder_gives_an_empty_page(tmp_path: Path) -> None:
    assert sections(write_report(tmp_path).read_text(encoding='utf-8')) == []


@pytest.mark.parametrize('name', ['range_image.npz', 'facade.ply', 'evaluation.json'])
def test_a_broken_part_is_named(full: Path, name: str) -> None:
    (full / name).write_bytes(b'\x00garbage')
    with pytest.raises(StriMappingError, match=name):
        write_report(full)


def test_a_drive_in_a_circle_is_not_compared_with_a_straight_one(tmp_path: Path) -> None:
    write_cloud(tmp_path, write_motion(tmp_path, yaw_rate=0.5))
    cloud = read_folder(tmp_path).cloud
    assert cloud is not None and cloud.before is None
    assert 'Before and after alignment' not in sections(write_report(tmp_path).read_text())


def test_facades_on_the_right_are_shown_as_such(tmp_path: Path) -> None:
    write_cloud(tmp_path, write_motion(tmp_path), side=-1.0)
    page = write_report(tmp_path).read_text(encoding='utf-8')
    assert 'Facade on the right' in page and 'Facade on the left' not in page


@pytest.mark.parametrize('direction', [1.0, -1.0], ids=['forwards', 'backwards'])
def test_unrolling_straightens_a_bend(direction: float) -> None:
    seconds = np.arange(0.0, 20.0, 0.05)
    # a left bend of radius 40 m; the wall on its outer, right side is 6 m away all along
    twist = direction * np.array([4.0, 0.0, 0.1])
    path = Trajectory(np.round(seconds * 1e9).astype(np.int64),
                      geometry.exp(seconds[:, None] * twist))
    driven = np.linspace(5.0, 75.0, 200)
    wall = geometry.compose(geometry.exp((driven / 4.0)[:, None] * twist), [0.0, -6.0, 0.0])
    xyz = np.column_stack([wall[:, :2], np.full(200, 2.0)])
    points = unroll(xyz, np.zeros(200), path)
    # path points lie 0.2 m apart: at 46 m from the centre the tangent of the nearest of them
    # strays by (0.1 / 40)^2 * 46 / 2 m in depth and stretches lengths by at most 46 / 40
    np.testing.assert_allclose(points.left, -6.0, atol=1e-3)
    np.testing.assert_allclose(points.along, driven, atol=0.03)


GRID = Grid(0.0, 4.0, 0.0, 2.0, 0.05)


def dots(step: float, left: float = 0.5, right: float = 3.5) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(left, right, step), np.arange(0.5, 1.5, step))
    return x.ravel() + 0.01, y.ravel() + 0.01


def test_gaps_between_points_close_and_nothing_grows() -> None:
    x, y = dots(0.15)
    image = nearest_depth(x, y, np.full(len(x), 7.0), GRID, reach=0.13)
    rows, columns = np.nonzero(np.isfinite(image))
    assert np.all(image[np.isfinite(image)] == 7.0)
    # every pixel between the outermost points, and none beyond them
    low, high = [int(v / 0.05) for v in (x.min(), x.max())]
    assert (columns.min(), columns.max()) == (low, high)
    inner = image[rows.min() + 2:rows.max() - 1, low + 2:high - 1]
    assert np.all(np.isfinite(inner))


def test_wide_openings_stay_open() -> None:
    left, right = dots(0.05, 0.5, 1.5), dots(0.05, 2.5, 3.5)
    x, y = np.concatenate([left[0], right[0]]), np.concatenate([left[1], right[1]])
    for image in (nearest_depth(x, y, np.ones(len(x)), GRID, reach=0.13),
                  blended(x, y, np.ones(len(x)), GRID, reach=0.13)):
        assert np.all(np.isnan(image[:, 32:48])) and np.isfinite(image[20, 20])


def test_the_nearer_surface_hides_what_shines_through() -> None:
    wall, column = dots(0.05), dots(0.1, 1.5, 2.5)
    x, y = np.concatenate([wall[0], column[0]]), np.concatenate([wall[1], column[1]])
    depth = np.concatenate([np.full(len(wall[0]), 9.0), np.full(len(column[0]), 6.0)])
    image = nearest_depth(x, y, depth, GRID, reach=0.13)
    assert np.all(image[14:26, 32:48] == 6.0)
    assert np.all(image[14:26, 14:26] == 9.0) and np.all(image[14:26, 54:66] == 9.0)


def test_blending_gives_the_mean_of_what_overlaps() -> None:
    x, y = dots(0.05)
    both = blended(np.tile(x, 2), np.tile(y, 2), np.repeat([10.0, 30.0], len(x)), GRID, 0.13)
    np.testing.assert_allclose(both[np.isfinite(both)], 20.0)


def test_views_hold_the_sides_that_have_walls(full: Path) -> None:
    data = read_folder(full)
    assert data.cloud is not None and data.path is not None
    view, = facade_views(data.cloud, data.path)
    assert view.left
    assert view.depths[0] < 8.0 < view.depths[1] and view.heights[1] > 6.5
    np.testing.assert_allclose(data.cloud.before, data.cloud.xyz, atol=1e-6)   # steady speed
