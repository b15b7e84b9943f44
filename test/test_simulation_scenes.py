# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
import json

import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.errors import UsageError
from stri_mapping.simulation.drive import make_drive, START_NS
from stri_mapping.simulation.furniture import shape
from stri_mapping.simulation.mesh import MeshBuilder, Surface
from stri_mapping.simulation.ray_cast import RayCaster
from stri_mapping.simulation.scenes import make_scene, Options, SCENES
from stri_mapping.simulation.site import Opening, Site
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, Vehicle

# Noise of 10 mm, and rounding to steps of 10 mm.
SENT_SIGMA = np.hypot(0.010, 0.010 / np.sqrt(12.0))
HORIZONTAL = Vehicle((load_vehicle(default_vehicle_file()).horizontal,))


@pytest.mark.parametrize('name', [n for n in SCENES if n not in ('loop', 'city')])
def test_every_scene_gives_plausible_scans_of_all_scanners(name):
    drive = make_drive(name, Options(seed=11, duration=1.5))
    scans, truth = list(drive.scans()), drive.truth()
    assert {t.scanner.name for t in scans} == {
        'horizontal', 'vertical_fore', 'vertical_side', 'vertical_aft'}
    assert np.all(np.diff([t.arrival_ns for t in scans]) >= 0)
    assert truth.duration == pytest.approx(1.5, abs=0.011)
    for scanner in {t.scanner.name for t in scans}:
        mine = [t.scan for t in scans if t.scanner.name == scanner]
        # a turn every 13.32 ms, less the one that has not ended
        assert len(mine) in (111, 112, 113)
        ranges = np.array([s.ranges for s in mine])
        # along a highway hardly anything stands as high as the horizontal scanner
        assert (0.01 if name == 'highway' else 0.4) < np.isfinite(ranges).mean() < 1.0
        assert np.nanmin(ranges) > 0.5 and not np.any(ranges == -np.inf)


    facts = json.loads(json.dumps(drive.facts()))
    assert facts['scene'] == name and facts['seed'] == 11
    assert facts['distance_m'] == pytest.approx(truth.distance, rel=1e-6, abs=1e-6)


def test_seeds_give_different_streets_and_a_seed_always_the_same():
    drives = [make_drive('street', Options(seed, 1.0), vehicle=HORIZONTAL) for seed in (1, 2, 1)]
    ranges = [[t.scan.ranges.tobytes() for t in d.scans()] for d in drives]
    assert ranges[0] == ranges[2]
    assert len(set(ranges[0] + ranges[1])) == len(ranges[0]) + len(ranges[1])


def test_columns_of_the_campus_stand_where_the_facts_say():
    scene = make_scene('campus')
    columns = scene.facts['columns']
    x = np.array([c['x'] for c in columns])
    assert np.allclose(np.diff(x), 6.0)
    middle = np.array([[c['x'], c['y'] - 3.0, 1.2] for c in columns])
    distance, cosine, _ = scene.still.cast(middle, np.tile([0.0, 1.0, 0.0], (len(x), 1)))
    assert np.allclose(distance, 3.0 - 0.5 * columns[0]['side']) and np.allclose(cosine, 1.0)
    # between two columns one looks into a window, behind the wall's face
    wall = scene.facts['walls'][0]
    between = middle[:-1] + [3.0, 0.0, 0.0]
    distance, _, _ = scene.still.cast(between, np.tile([0.0, 1.0, 0.0], (len(x) - 1, 1)))
    assert np.allclose(between[:, 1] + distance, wall['from'][1] + 0.3)


def test_bare_wall_is_93_m_long_and_campus_170_m_far():
    bare = [w for w in make_scene('bare_wall').facts['walls'] if w['material'] == 'plaster']
    assert np.hypot(*np.subtract(bare[0]['to'], bare[0]['from'])) == pytest.approx(93.0)
    assert make_drive('campus').truth().distance == pytest.approx(170.0, abs=0.01)


def test_loop_comes_back_to_its_start_after_a_kilometre():
    truth = make_drive('loop', vehicle=HORIZONTAL).truth()
    assert 950.0 < truth.distance < 1050.0
    # the last knot is up to one step before the end
    assert np.hypot(*(truth.poses[-1] - truth.poses[0])[:2]) < 1.5
    assert truth.poses[-1, 2] - truth.poses[0, 2] == pytest.approx(2.0 * np.pi, abs=1e-3)


def test_reverse_drives_backwards_and_stops_stand_still():
    backwards = make_scene('reverse').motion.twist(np.arange(0.0, 36.0, 0.1))[:, 0]
    assert backwards.max() < 0.05 and backwards.min() < -3.5
    go = np.abs(make_scene('stops').motion.twist(np.arange(0.0, 40.0, 0.1))[:, 0]) < 0.01
    assert np.count_nonzero(np.diff(go.astype(int)) == 1) >= 2


def test_traffic_changes_neither_street_nor_ride():
    full, empty = (make_scene('street', Options(3, 5.0, traffic=x)) for x in (1.0, 0.0))
    assert np.array_equal(full.mesh.triangles, empty.mesh.triangles)
    t = np.arange(0.0, 5.0, 0.1)
    assert np.array_equal(full.motion.at(t), empty.motion.at(t))
    assert full.movers and not empty.movers


def test_nothing_stands_in_the_vehicles_way():
    # a line of rays along the path, 0.9 m to both sides, at bumper height
    for seed in (1, 2):
        scene = make_scene('corner', Options(seed))
        t = np.arange(0.0, scene.duration - 0.1, 0.1)
        pose, after = scene.motion.at(t), scene.motion.at(t + 0.1)
        for side in (-0.9, 0.9):
            here, there = (np.column_stack([
                p[:, 0] - side * np.sin(p[:, 5]), p[:, 1] + side * np.cos(p[:, 5]),
                np.full(len(t), 0.5)]) for p in (pose, after))
            step = np.linalg.norm(there - here, axis=1)
            distance, _, _ = scene.still.cast(here, (there - here) / step[:, None])
            assert np.all(distance > step)


def test_wall_with_openings_is_closed():
    site = Site(MeshBuilder(), np.random.default_rng(1), {}, np.eye(4))
    face, pane = Surface('face', 0.5), Surface('pane', 0.1)
    site.at(1.0, 2.0, 0.4).wall(0.0, 0.0, 10.0, 6.0, face, [
        Opening(1.0, 3.0, 1.0, 2.5, 0.3, pane), Opening(3.0, 4.0, 0.0, 2.5, -0.2, pane),
        Opening(6.0, 9.0, 1.0, 5.0, 1.5, pane)])
    scene = site.builder.mesh()
    caster = RayCaster(scene)
    rng = np.random.default_rng(2)
    at = np.column_stack([rng.uniform(0.05, 9.95, 4000), np.full(4000, -5.0),
                          rng.uniform(0.05, 5.95, 4000)])
    T = geometry.transform((1.0, 2.0, 0.0), (0.0, 0.0, 0.4))
    distance, _, triangle = caster.cast(at @ T[:3, :3].T + T[:3, 3],
                                        np.tile(T[:3, 1], (4000, 1)))
    x, z = at[:, 0], at[:, 2]
    expected = np.full(4000, 5.0)
    expected[(1 < x) & (x < 3) & (1 < z) & (z < 2.5)] = 5.3
    expected[(3 < x) & (x < 4) & (z < 2.5)] = 4.8
    expected[(6 < x) & (x < 9) & (1 < z) & (z < 5)] = 6.5
    assert np.allclose(distance, expected, atol=1e-9)


@pytest.mark.parametrize('kind', ['pedestrian', 'car', 'estate', 'van', 'truck', 'bus'])
def test_shapes_have_the_size_of_their_kind(kind):
    mesh = shape(np.random.default_rng(4), kind)
    low, high = mesh.triangles.reshape(-1, 3).min(0), mesh.triangles.reshape(-1, 3).max(0)
    length, width, height = high - [low[0], low[1], 0.0]
    assert low[2] >= -1e-6
    assert {'pedestrian': (0.3, 1.0), 'bus': (11.9, 12.1)}.get(kind, (3.8, 8.6))[0] < length
    assert length < {'pedestrian': (0.3, 1.0), 'bus': (11.9, 12.1)}.get(kind, (3.8, 8.6))[1]
    assert width < 2.7 and 1.3 < height < 3.6


@pytest.mark.parametrize('name, options, text', [
    ('moon', Options(), 'unknown scene "moon".*campus'),
    ('campus', Options(duration=99.0), 'campus lasts 34.0 s'),
    ('street', Options(duration=-1.0), 'duration is -1.0'),
    ('street', Options(seed=-3), 'seed is -3'),
    ('street', Options(vibration=float('nan')), 'vibration is nan'),
    ('street', Options(traffic=11.0), 'traffic is 11.0')])
def test_wrong_options_are_refused_by_name(name, options, text):
    with pytest.raises(UsageError, match=text):
        make_scene(name, options)


def test_vertical_scans_put_road_and_wall_where_they_are():
    drive = make_drive('campus', Options(duration=1.0))
    side = next(s for s in drive.scanners if s.scanner.name == 'vertical_side')
    points = []
    for timed in side.stream(1.0):
        scan = timed.scan
        times = 1e-9 * (scan.stamp_ns - START_NS) + scan.times
        for pose, xy in zip(drive.scene.motion.at(times), scan.points):
            T = geometry.transform(pose[:3], pose[3:]) @ side.scanner.T_base_laser
            points.append(T[:3, :2] @ xy + T[:3, 3])
    x, y, z = np.array(points).T
    # the road up to the kerb, as steep as the noise of 10 mm plus a bias of 12 mm allows
    road = (y > 0.7) & (y < 3.4) & (z < 1.0)
    assert road.sum() > 1000 and np.abs(z[road]).max() < 6 * SENT_SIGMA + 0.012
    assert abs(np.median(z[road])) < 0.015
    # the wall's face and, recessed, its panes, between the columns' row and the eaves
    high = (y > 8.0) & (z > 0.3) & (z < 6.5)
    depth = np.minimum(np.abs(y[high] - 8.6), np.abs(y[high] - 8.9))
    # the rest hit an edge or the side of a window, one ray in thirty or so
    assert high.sum() > 2000 and np.mean(depth < 3 * SENT_SIGMA + 0.012) > 0.94
