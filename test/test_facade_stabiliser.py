# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Roll, pitch and heave from vertical scans: against the truth, and where nothing tells them."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.typing import NDArray
import pytest

from stri_mapping.facade.points import FACADE, FacadePoints, GROUND
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.geometry import rotation_from_rpy
from stri_mapping.scan import Scan
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, Scanner

Array = NDArray[np.float64]
TURN_NS = 13_320_000
T0 = 1_700_000_000_000_000_000
ANGLES = np.deg2rad(np.arange(-90.0, 91.0))
TIMES = np.arange(181) * TURN_NS * 1e-9 / 360.0
SPEED = 6.0
VERTICALS = load_vehicle(default_vehicle_file()).verticals
Body = Callable[[float], tuple[float, float, float]]


def ray_planes(origin: Array, rays: Array, planes: list[tuple[Array, float]]) -> Array:
    """Return the distance (n,) along rays (n, 3) to the nearest plane normal . p = d; or inf."""
    reach = np.full(len(rays), np.inf)
    for normal, distance in planes:
        with np.errstate(divide='ignore'):
            to = (distance - origin @ normal) / (rays @ normal)
        reach = np.minimum(reach, np.where(to > 0.05, to, np.inf))
    return reach


ROAD = (np.array([0.0, 0.0, 1.0]), 0.0)
WALL = (np.array([0.0, 1.0, 0.0]), 9.0)


def scan_at(mount: Scanner, stamp: int, body: Body, planes: list[tuple[Array, float]],
            rng: np.random.Generator, angles: Array = ANGLES) -> Scan:
    """Return a scan of planes from a body that rolls, pitches and heaves on a straight drive."""
    seconds = (stamp - T0) * 1e-9
    roll, pitch, heave = body(seconds)
    T = np.eye(4)
    T[:3, :3] = rotation_from_rpy(roll, pitch, 0.0)
    T[:3, 3] = (SPEED * seconds, 0.0, heave)
    T = T @ mount.T_base_laser
    rays = np.cos(angles)[:, None] * T[:3, 0] + np.sin(angles)[:, None] * T[:3, 1]
    ranges = ray_planes(T[:3, 3], rays, planes) + rng.normal(0.0, 0.01, len(angles))
    ranges[~np.isfinite(ranges) | (ranges > 40.0)] = np.inf
    # all rays at the stamp: what a moving scanner does to a scan is push_broom's own test
    return Scan(stamp, ranges, angles, np.zeros(len(angles)), range_max=80.0)


def drive(body: Body, planes: list[tuple[Array, float]], seconds: float = 4.0,
          mounts: tuple[Scanner, ...] = VERTICALS, takes: int = 1, seed: int = 0,
          scanning: Callable[[int, int], bool] = lambda ring, k: True,
          ) -> tuple[FacadeAligner, FacadePoints, Array]:
    """Drive past planes; return the aligner, its points, and its poses (n, 6)."""
    rng, aligner = np.random.default_rng(seed), FacadeAligner(mounts)
    turns = int(seconds * 1e9 / TURN_NS)
    for k in range(turns):
        for ring, mount in enumerate(mounts):
            if scanning(ring, k):
                stamp = T0 + k * TURN_NS + ring * 4_000_000
                aligner.add_scan(ring, scan_at(mount, stamp, body, planes, rng))
    stamps = T0 + np.arange(turns + 1) * TURN_NS
    poses = np.column_stack([SPEED * (stamps - T0) * 1e-9, 0 * stamps, 0 * stamps])
    pieces, found = [], []
    for own in np.array_split(np.arange(len(stamps)), takes):
        aligner.add_poses(stamps[own], poses[own])
        pieces.append(aligner.take_points())
        found.append(aligner.take_poses()[1])
    aligner.finish()
    pieces.append(aligner.take_points())
    found.append(aligner.take_poses()[1])
    xyz = np.concatenate([p.xyz for p in pieces])
    points = FacadePoints(xyz, *(np.concatenate([getattr(p, name) for p in pieces]) for name in (
        'intensity', 'stamps_ns', 'ring', 'label')))
    return aligner, points, np.concatenate(found)


def swaying(seconds: float) -> tuple[float, float, float]:
    """Return what springs of 1.4 Hz do: 0.35 degrees of roll and pitch, 6 mm of heave."""
    phase = 2.0 * np.pi * 1.4 * seconds
    return (np.deg2rad(0.35) * np.sin(phase), np.deg2rad(0.35) * np.cos(0.9 * phase),
            0.006 * np.sin(0.8 * phase))


def test_a_swaying_body_is_stilled_and_the_wall_comes_out_flat() -> None:
    aligner, points, poses = drive(swaying, [ROAD, WALL])
    seconds = np.arange(len(poses)) * TURN_NS * 1e-9
    truth = np.array([swaying(t) for t in seconds])
    inner = slice(20, -20)
    error = np.rad2deg(poses[inner, 3:5] - truth[inner, :2])
    # 60 road rays of 10 mm over 4 m tell the roll of a scan to 0.02 degrees; the sway itself is
    # 0.25 degrees rms.  The rest is the spline's bend and the walls' 0.1 degrees of freedom.
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.06
    assert np.sqrt(np.mean((poses[inner, 2] - truth[inner, 2]) ** 2)) < 0.003
    wall = points.xyz[(points.label == FACADE) & (points.xyz[:, 2] > 0.5)]
    assert len(wall) > 10_000
    assert np.sqrt(np.mean((wall[:, 1] - 9.0) ** 2)) < 0.014      # the noise alone gives 0.010
    road = points.xyz[points.label == GROUND]
    assert np.sqrt(np.mean(road[:, 2] ** 2)) < 0.012
    assert aligner.counts.roll_told == aligner.counts.pitch_told == len(points)


angle = st.floats(-1.0, 1.0).map(np.deg2rad)


@given(angle, angle, st.floats(-0.03, 0.03))
@settings(max_examples=8, deadline=None)
def test_a_constant_attitude_is_found(roll: float, pitch: float, heave: float) -> None:
    _, _, poses = drive(lambda t: (roll, pitch, heave), [ROAD, WALL], 2.0)
    middle = poses[40:-40]
    np.testing.assert_allclose(np.rad2deg(middle[:, 3] - roll), 0.0, atol=0.12)
    np.testing.assert_allclose(np.rad2deg(middle[:, 4] - pitch), 0.0, atol=0.06)
    np.testing.assert_allclose(middle[:, 2], heave, atol=0.004)


def test_walls_tell_the_roll_on_a_road_that_slopes_across() -> None:
    slope = np.deg2rad(1.4)                      # a crossfall of 2.5 %
    road = (np.array([0.0, -np.sin(slope), np.cos(slope)]), 0.0)
    _, _, poses = drive(lambda t: (slope, 0.0, 0.0), [road, WALL], 20.0)
    # the vehicle stands square on the road: only the wall says that it leans
    assert np.rad2deg(np.abs(poses[-400:, 3] - slope)).mean() < 0.15


def test_where_nothing_is_told_the_planar_path_stays() -> None:
    far = (np.array([1.0, 0.0, 0.0]), 1e5)
    rng = np.random.default_rng(3)
    aligner, points, poses = drive(swaying, [far], 2.0)
    assert len(points) == 0
    aligner = FacadeAligner(VERTICALS)
    for k in range(100):                         # leaves: no two points in line
        ranges = rng.uniform(3.0, 12.0, 181)
        ranges[:100] = np.inf
        aligner.add_scan(1, Scan(T0 + k * TURN_NS, ranges, ANGLES, TIMES, range_max=80.0))
    stamps = T0 + np.arange(110) * TURN_NS
    aligner.add_poses(stamps, np.column_stack([stamps - T0, 0 * stamps, 0 * stamps]) * 1e-9)
    aligner.finish()
    points, (_, poses) = aligner.take_points(), aligner.take_poses()
    assert aligner.counts.points == len(points) > 1000
    assert aligner.counts.roll_told == aligner.counts.pitch_told == 0
    np.testing.assert_allclose(poses[:, 2:5], 0.0, atol=1e-9)


def test_one_scanner_square_to_the_drive_tells_roll_but_not_pitch() -> None:
    aligner, points, poses = drive(swaying, [ROAD, WALL], 3.0, scanning=lambda ring, _: ring == 1)
    assert set(points.ring) == {1}
    truth = np.array([swaying(k * TURN_NS * 1e-9) for k in range(len(poses))])
    # the prior holds the pitch at zero but for a fifth of the sway, left by roll and heave
    assert np.rad2deg(np.sqrt(np.mean(poses[20:-20, 4] ** 2))) < 0.08
    error = np.rad2deg(poses[20:-20, 3] - truth[20:-20, 0])
    assert np.sqrt(np.mean(error**2)) < 0.08
    assert aligner.counts.roll_told > 0.9 * len(points)
    assert aligner.counts.pitch_told < 0.05 * len(points)


@pytest.mark.parametrize('dead', [0, 1, 2])
def test_a_dead_scanner_costs_little(dead: int) -> None:
    aligner, points, poses = drive(swaying, [ROAD, WALL], 3.0,
                                   scanning=lambda ring, k: ring != dead or k < 50)
    truth = np.array([swaying(k * TURN_NS * 1e-9) for k in range(len(poses))])
    error = np.rad2deg(poses[20:-20, 3:5] - truth[20:-20, :2])
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.1
    assert aligner.counts.points == len(points)


def test_scanners_may_differ_in_rate() -> None:
    aligner, points, poses = drive(swaying, [ROAD, WALL], 3.0,
                                   scanning=lambda ring, k: k % (1, 3, 8)[ring] == 0)
    truth = np.array([swaying(k * TURN_NS * 1e-9) for k in range(len(poses))])
    error = np.rad2deg(poses[20:-20, 3:5] - truth[20:-20, :2])
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.1


@pytest.mark.parametrize('takes', [3, 40])
def test_points_are_the_same_however_the_path_arrives(takes: int) -> None:
    _, at_once, poses = drive(swaying, [ROAD, WALL], 3.0)
    _, piecewise, others = drive(swaying, [ROAD, WALL], 3.0, takes=takes)
    assert len(at_once) == len(piecewise)
    a, b = (np.lexsort([p.ring, p.stamps_ns, p.xyz[:, 2]]) for p in (at_once, piecewise))
    # sums of the same numbers in another order
    np.testing.assert_allclose(at_once.xyz[a], piecewise.xyz[b], atol=1e-9)
    np.testing.assert_array_equal(at_once.label[a], piecewise.label[b])
    np.testing.assert_allclose(poses, others, atol=1e-9)


def test_scans_that_come_after_their_poses_still_tell() -> None:
    rng, stamps = np.random.default_rng(0), T0 + np.arange(400) * TURN_NS
    scans = [[scan_at(mount, int(t) + ring * 4_000_000, swaying, [ROAD, WALL], rng)
              for t in stamps[:-4]] for ring, mount in enumerate(VERTICALS)]
    path = np.column_stack([SPEED * (stamps - T0) * 1e-9, 0 * stamps, 0 * stamps])
    found = []
    for late in (-100, 100, 390):                # scans 1.3 s before, or up to 5 s after, poses
        aligner, pieces = FacadeAligner(VERTICALS), []
        for k in range(-100, 800, 20):
            for ring, own in enumerate(scans):
                for scan in own[max(k - late, 0):max(k - late + 20, 0)]:
                    aligner.add_scan(ring, scan)
            own = slice(max(k, 0), max(k + 20, 0))
            aligner.add_poses(stamps[own], path[own])
            pieces.append(aligner.take_points().xyz)
        aligner.finish()
        found.append(np.concatenate([*pieces, aligner.take_points().xyz]))
    a, *others = (points[np.lexsort(points.round(6).T)] for points in found)
    for b in others:
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_points_come_soon_after_their_path() -> None:
    rng, aligner = np.random.default_rng(0), FacadeAligner(VERTICALS[1:2])
    for k in range(300):
        aligner.add_scan(0, scan_at(VERTICALS[1], T0 + k * TURN_NS, swaying, [ROAD, WALL], rng))
    stamps = T0 + np.arange(301) * TURN_NS
    aligner.add_poses(stamps, np.column_stack([stamps - T0, 0 * stamps, 0 * stamps]) * 1e-9)
    newest = aligner.take_points().stamps_ns.max()
    # a sweep's slack, three intervals of lag, three of the spline, one to be complete, one batch
    assert stamps[-1] - newest < 1.7e9
    # where scanners can be compared: two intervals more, and two until they are complete
    aligner = FacadeAligner(VERTICALS)
    for k in range(300):
        for ring, mount in enumerate(VERTICALS):
            aligner.add_scan(ring, scan_at(mount, T0 + k * TURN_NS + ring, swaying, [ROAD, WALL],
                                           rng))
    aligner.add_poses(stamps, np.column_stack([stamps - T0, 0 * stamps, 0 * stamps]) * 1e-9)
    assert stamps[-1] - aligner.take_points().stamps_ns.max() < 2.7e9


def test_a_pause_of_the_scanners_begins_a_new_stretch() -> None:
    aligner, points, poses = drive(swaying, [ROAD, WALL], 9.0,
                                   scanning=lambda ring, k: not 200 <= k < 500)
    seconds = np.arange(len(poses)) * TURN_NS * 1e-9
    truth = np.array([swaying(t) for t in seconds])
    paused = (seconds > 200 * 0.01332 + 0.3) & (seconds < 500 * 0.01332 - 0.3)
    np.testing.assert_array_equal(poses[paused, 2:5], 0.0)
    assert len(poses) == len(truth)
    told = ~((seconds > 200 * 0.01332 - 0.2) & (seconds < 500 * 0.01332 + 0.2))
    error = np.rad2deg(poses[told, 3:5] - truth[told, :2])[20:-20]
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.08
    assert aligner.counts.points == len(points)


def test_fields_of_view_may_differ() -> None:
    rng, aligner = np.random.default_rng(0), FacadeAligner(VERTICALS)
    fields = [np.deg2rad(np.arange(*limits)) for limits in (
        (-90.0, 91.0, 1.0), (-50.0, 50.5, 0.5), (-90.0, 0.5, 0.25))]
    for k in range(200):
        for ring, (mount, angles) in enumerate(zip(VERTICALS, fields)):
            stamp = T0 + k * TURN_NS + ring * 4_000_000
            aligner.add_scan(ring, scan_at(mount, stamp, swaying, [ROAD, WALL], rng, angles))
    stamps = T0 + np.arange(205) * TURN_NS
    aligner.add_poses(stamps, np.column_stack(
        [SPEED * (stamps - T0) * 1e-9, 0 * stamps, 0 * stamps]))
    aligner.finish()
    points, (_, poses) = aligner.take_points(), aligner.take_poses()
    assert aligner.counts.points == len(points)
    assert set(points.ring) == {0, 1, 2}
    truth = np.array([swaying(k * TURN_NS * 1e-9) for k in range(len(poses))])
    error = np.rad2deg(poses[20:-20, 3:5] - truth[20:-20, :2])
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.1


def test_a_path_shorter_than_the_scans_leaves_the_rest_out() -> None:
    rng, aligner = np.random.default_rng(0), FacadeAligner(VERTICALS)
    scans = [scan_at(VERTICALS[1], T0 + k * TURN_NS, swaying, [ROAD, WALL], rng)
             for k in range(300)]
    for scan in scans:
        aligner.add_scan(1, scan)
    stamps = T0 + np.arange(100, 200) * TURN_NS
    aligner.add_poses(stamps, np.column_stack(
        [SPEED * (stamps - T0) * 1e-9, 0 * stamps, 0 * stamps]))
    aligner.finish()
    points, (got, _) = aligner.take_points(), aligner.take_poses()
    assert stamps[0] <= points.stamps_ns.min() and points.stamps_ns.max() <= stamps[-1]
    hits = np.array([np.count_nonzero(scan.valid) for scan in scans])
    assert len(points) == hits[100:200].sum()
    assert aligner.counts.outside == hits.sum() - len(points) > 0
    np.testing.assert_array_equal(got, stamps)


def test_a_street_with_a_shaking_car_is_stilled() -> None:
    pytest.importorskip('embreex')
    from stri_mapping.simulation.drive import make_drive, START_NS
    from stri_mapping.simulation.nearest import Surfaces
    from stri_mapping.simulation.scenes import Options
    drive = make_drive('street', Options(seed=3, duration=8.0, vibration=3.5))
    rings = {s.name: ring for ring, s in enumerate(drive.vehicle.verticals)}
    stilled, planar = (FacadeAligner(drive.vehicle.verticals, stabilise=s) for s in (True, False))
    for timed in drive.scans():
        if timed.scanner.name in rings:
            for aligner in (stilled, planar):
                aligner.add_scan(rings[timed.scanner.name], timed.scan)
    path, surfaces, off = drive.truth(), Surfaces(drive.scene.mesh.triangles), []
    for aligner in (stilled, planar):
        aligner.add_poses(path.stamps_ns, path.poses)
        aligner.finish()
        points = aligner.take_points()
        high = (points.label == FACADE) & (points.xyz[:, 2] > 0.5) & (points.xyz[:, 2] < 15.0)
        xyz = points.xyz[high][::5]
        away = np.linalg.norm(xyz - surfaces.nearest(xyz), axis=1)
        off.append(np.sqrt(np.mean(away[away < 0.15] ** 2)))
    stamps, poses = stilled.take_poses()
    truth = drive.scene.motion.at((stamps - START_NS) * 1e-9)
    assert np.rad2deg(truth[:, 3:5].std(axis=0)).min() > 0.15
    error = np.rad2deg(np.sqrt(np.mean((poses[:, 3:5] - truth[:, 3:5]) ** 2, axis=0)))
    # the walls of 8 s tell what is upright to 0.05 degrees, the road the rest to 0.02
    assert error.max() < 0.1
    # perfect poses give 16 mm: noise of 12, edges, slanted footprints
    assert off[0] < 0.022 < 0.027 < off[1]


def test_stamps_may_begin_at_zero() -> None:
    rng, aligner = np.random.default_rng(0), FacadeAligner(VERTICALS)
    for k in range(150):
        scan = scan_at(VERTICALS[1], T0 + k * TURN_NS, swaying, [ROAD, WALL], rng)
        aligner.add_scan(1, Scan(k * TURN_NS, scan.ranges, scan.angles, scan.times))
    stamps = np.arange(160) * TURN_NS
    aligner.add_poses(stamps, np.column_stack([stamps, 0 * stamps, 0 * stamps]) * 1e-9)
    aligner.finish()
    points = aligner.take_points()
    # half a second of walls tells the road's crossfall from the vehicle's roll
    assert aligner.counts.roll_told > 0.75 * len(points) > 10_000


def test_a_path_without_scans_comes_back_planar() -> None:
    aligner = FacadeAligner(VERTICALS)
    stamps = T0 + np.arange(2000) * TURN_NS
    flat = np.column_stack([stamps - T0, 0 * stamps, 0 * stamps]) * 1e-9
    got = []
    for k in range(0, 2000, 100):
        aligner.add_poses(stamps[k:k + 100], flat[k:k + 100])
        assert len(aligner.take_points()) == 0
        got.append(aligner.take_poses())
    assert sum(len(s) for s, _ in got) > 1800            # nothing is held back for long
    aligner.finish()
    aligner.take_points()
    got.append(aligner.take_poses())
    np.testing.assert_array_equal(np.concatenate([s for s, _ in got]), stamps)
    poses = np.concatenate([p for _, p in got])
    np.testing.assert_allclose(poses[:, [0, 1, 5]], flat, atol=1e-12)
    assert not poses[:, 2:5].any()
