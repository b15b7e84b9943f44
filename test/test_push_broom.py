# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.facade import push_broom
from stri_mapping.facade.placing import at_constant_speed, place
from stri_mapping.facade.points import concatenate, FacadePoints
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.scan import Scan
from stri_mapping.trajectory import constant_speed, Trajectory
from stri_mapping.vehicle import Scanner

TURN_NS = 13_320_000
START_NS = 1_700_000_000_000_000_000
TWIST = np.array([8.0, 0.3, 0.4])               # a bend at 8 m/s, with some side slip
ANGLES = np.deg2rad(np.arange(-90.0, 91.0))
TIMES = np.arange(181) * TURN_NS * 1e-9 / 360.0


def drive(seconds: float, step_ns: int = TURN_NS) -> Trajectory:
    """Return a path of constant twist: interpolation along the geodesic is then exact."""
    stamps = START_NS + np.arange(int(seconds * 1e9) // step_ns) * step_ns
    return Trajectory(stamps, geometry.exp(((stamps - START_NS) * 1e-9)[:, None] * TWIST))


def scanner(name: str, xyz: tuple[float, ...], rpy: tuple[float, ...]) -> Scanner:
    return Scanner(name, 'vertical', geometry.transform(xyz, rpy), f'{name}_laser', f'{name}/scan')


SIDE = scanner('side', (0.1, 0.6, 1.9), (np.pi / 2, 0.0, np.pi / 2))
FORE = scanner('fore', (0.6, 0.6, 1.9), (np.pi / 2, 0.0, np.pi / 4))
RIGHT_UPSIDE_DOWN = scanner('right', (0.0, -0.6, 2.0), (-np.pi / 2, 0.1, -np.pi / 2))


def from_base(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points of base_link in odom, each by its own planar pose."""
    return place(points, poses, np.zeros((len(points), 3)), np.zeros(3))


def laser_pose(mount: Scanner, seconds: float) -> np.ndarray:
    """Return T_odom_laser at a time of the drive."""
    x, y, yaw = geometry.exp(seconds * TWIST)
    return geometry.transform([x, y, 0.0], [0.0, 0.0, yaw]) @ mount.T_base_laser


def scan_of_plane(mount: Scanner, stamp_ns: int, normal: np.ndarray, distance: float) -> Scan:
    """Return what a scanner on the moving vehicle measures of the plane normal * p = distance."""
    ranges = np.full(len(ANGLES), np.inf)
    for i, (angle, time) in enumerate(zip(ANGLES, TIMES)):
        T = laser_pose(mount, (stamp_ns - START_NS) * 1e-9 + time)
        along = normal @ T[:3, :3] @ [np.cos(angle), np.sin(angle), 0.0]
        reach = (distance - normal @ T[:3, 3]) / along if along else np.inf
        ranges[i] = reach if 0.0 < reach < 80.0 else np.inf
    return Scan(stamp_ns, ranges, ANGLES, TIMES, range_max=80.0)


def noise_scan(stamp_ns: int, seed: int) -> Scan:
    """Return a scan of random ranges, some without return."""
    rng = np.random.default_rng(seed)
    ranges = np.where(rng.random(181) < 0.2, np.inf, rng.uniform(2.0, 30.0, 181))
    return Scan(stamp_ns, ranges, ANGLES, TIMES, rng.uniform(0.0, 255.0, 181), range_max=80.0)


@pytest.mark.parametrize('mount', [SIDE, FORE, RIGHT_UPSIDE_DOWN], ids=lambda s: s.name)
def test_a_wall_measured_while_driving_round_a_bend_is_flat(mount: Scanner) -> None:
    side = 1.0 if mount.T_base_laser[1, 3] > 0.0 else -1.0
    normal, distance = np.array([0.1, side, 0.05]), 12.0
    normal /= np.linalg.norm(normal)
    path = drive(1.0)
    scans = [scan_of_plane(mount, START_NS + i * 7 * TURN_NS + 5_000_000, normal, distance)
             for i in range(9)]
    aligner = FacadeAligner([mount], stabilise=False)
    for each in scans:
        aligner.add_scan(0, each)
    aligner.add_poses(path.stamps_ns, path.poses)
    points = aligner.take_points()
    assert len(points) == sum(each.valid.sum() for each in scans) > 9 * 80
    # float64 poses of tens of metres and ranges under 80 m: rounding is 1e-13 m, ray times are
    # kept to whole nanoseconds, which at 8 m/s is 4e-9 m
    off = points.xyz @ normal - distance
    assert np.max(np.abs(off)) < 2e-8

    # the same points placed by the pose at their scan's stamp are off by the motion in a scan
    stamps = np.concatenate([np.full(each.valid.sum(), each.stamp_ns) for each in scans])
    moved = geometry.compose(path.at(stamps), geometry.inverse(path.at(points.stamps_ns)))
    planar = np.column_stack([points.xyz[:, :2], np.zeros(len(points))])
    shifted = geometry.compose(moved, planar)
    wrong = np.column_stack([shifted[:, :2], points.xyz[:, 2]]) @ normal - distance
    assert np.max(np.abs(wrong)) > 0.01


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 6))
@settings(max_examples=50, deadline=None)
def test_any_mount_keeps_ranges_and_the_matrix_product(numbers: tuple[float, ...]) -> None:
    mount = Scanner('any', 'vertical', geometry.transform(numbers[:3], numbers[3:]), 'f', 't')
    path, each = drive(0.2), noise_scan(START_NS + 3 * TURN_NS, 1)
    aligner = FacadeAligner([mount], stabilise=False)
    aligner.add_poses(path.stamps_ns, path.poses)
    aligner.add_scan(0, each)
    points = aligner.take_points()
    for i in (0, len(points) // 2, len(points) - 1):
        T = laser_pose(mount, (points.stamps_ns[i] - START_NS) * 1e-9)
        ray = np.flatnonzero(each.valid)[i]
        p = np.array([*each.points[ray], 0.0, 1.0])
        np.testing.assert_allclose(points.xyz[i], (T @ p)[:3], atol=1e-8)
        reach = np.linalg.norm(points.xyz[i] - T[:3, 3])
        assert reach == pytest.approx(each.ranges[ray], abs=1e-8)


def test_rays_without_a_pose_are_counted_and_left_out() -> None:
    path = drive(3.0)
    seconds = (path.stamps_ns - START_NS) * 1e-9
    keep = (seconds > 0.5) & ~((seconds > 1.0) & (seconds < 1.8)) & (seconds < 2.5)
    keep &= ~((seconds > 2.0) & (seconds < 2.3))        # a gap short enough to be bridged
    path = Trajectory(path.stamps_ns[keep], path.poses[keep])
    aligner = FacadeAligner([SIDE], stabilise=False)
    scans = [noise_scan(START_NS + i * TURN_NS + 1, i) for i in range(220)]
    for each in scans:
        aligner.add_scan(0, each)
    aligner.add_poses(path.stamps_ns, path.poses)
    aligner.finish()
    points = aligner.take_points()

    ray_stamps = np.concatenate([e.stamp_ns + np.rint(e.times * 1e9).astype(int) for e in scans])
    hit = np.concatenate([e.valid for e in scans])
    steps = np.diff(path.stamps_ns)
    gap = int(np.argmax(steps))
    inside = (path.stamps_ns[0] <= ray_stamps) & (ray_stamps <= path.stamps_ns[-1]) & ~(
        (path.stamps_ns[gap] < ray_stamps) & (ray_stamps < path.stamps_ns[gap + 1]))
    assert steps[gap] > 0.5e9 > np.sort(steps)[-2] > 0.2e9
    np.testing.assert_array_equal(np.sort(points.stamps_ns), np.sort(ray_stamps[hit & inside]))
    counts = aligner.counts
    assert (counts.points, counts.no_return) == (len(points), np.count_nonzero(~hit))
    assert counts.outside == np.count_nonzero(hit & ~inside) > 0
    assert counts.points + counts.no_return + counts.outside == 181 * 220


def run_interleaved(order: list[int], takes: list[bool]) -> tuple[FacadePoints, FacadeAligner]:
    """Feed two scanners (0, 1) and the poses (2) in a given order; take points where told."""
    path = drive(0.6)
    streams = [iter([noise_scan(START_NS + i * TURN_NS + shift, i + 100 * ring)
                     for i in range(30)]) for ring, shift in enumerate((1_000_000, 9_000_000))]
    poses = iter(range(0, len(path), 2))
    aligner, pieces = FacadeAligner([SIDE, FORE], stabilise=False), []
    for who, take in zip(order, takes):
        if who == 2:
            k = next(poses, None)
            if k is not None:
                aligner.add_poses(path.stamps_ns[k:k + 2], path.poses[k:k + 2])
        else:
            each = next(streams[who], None)
            if each is not None:
                aligner.add_scan(who, each)
        if take:
            pieces.append(aligner.take_points())
    for ring, rest in enumerate(streams):
        for each in rest:
            aligner.add_scan(ring, each)
    for k in poses:
        aligner.add_poses(path.stamps_ns[k:k + 2], path.poses[k:k + 2])
    aligner.finish()
    return concatenate([*pieces, aligner.take_points()]), aligner


def sorted_rows(points: FacadePoints) -> np.ndarray:
    order = np.lexsort([points.stamps_ns, points.ring])
    return np.column_stack([points.ring, points.stamps_ns - START_NS, points.xyz,
                            points.intensity])[order]


@given(st.lists(st.tuples(st.integers(0, 2), st.booleans()), max_size=120))
@settings(max_examples=40, deadline=None)
def test_points_do_not_depend_on_the_order_of_arrival(events: list[tuple[int, bool]]) -> None:
    straight, expected = run_interleaved([], [])
    points, aligner = run_interleaved([who for who, _ in events], [take for _, take in events])
    np.testing.assert_array_equal(sorted_rows(points), sorted_rows(straight))
    assert aligner.counts == expected.counts
    assert aligner.take_points().xyz.shape == (0, 3)     # each point is handed out once


def test_scans_wait_for_the_pose_after_their_last_ray() -> None:
    path = drive(0.2)
    aligner = FacadeAligner([SIDE], stabilise=False)
    aligner.add_scan(0, noise_scan(START_NS + TURN_NS, 0))
    aligner.add_poses(path.stamps_ns[:2], path.poses[:2])
    assert len(aligner.take_points()) == 0               # the pose at the first ray is not enough
    aligner.add_poses(path.stamps_ns[:3], path.poses[:3])
    assert len(aligner.take_points()) == aligner.counts.points > 100


def test_repeated_and_older_poses_and_scans_are_ignored() -> None:
    path = drive(0.4)
    aligner = FacadeAligner([SIDE, FORE], stabilise=False)
    aligner.add_poses(path.stamps_ns, path.poses)
    aligner.add_poses(path.stamps_ns, path.poses + 1.0)
    aligner.add_poses(path.stamps_ns[:5], path.poses[:5] - 1.0)
    each = noise_scan(START_NS + TURN_NS, 3)
    for _ in range(2):
        aligner.add_scan(0, each)
    aligner.add_scan(0, noise_scan(START_NS, 4))
    aligner.add_scan(1, each)                            # another scanner has a clock of its own
    points = aligner.take_points()
    assert (aligner.counts.scans, aligner.counts.out_of_order) == (2, 2)
    assert np.all(np.bincount(points.ring) == each.valid.sum())
    expected = from_base(path.at(points.stamps_ns[:1]), np.array([[*SIDE.T_base_laser[:3, 3]]]))
    reach = np.linalg.norm(points.xyz[0] - expected[0])
    assert reach == pytest.approx(each.ranges[each.valid][0], abs=1e-6)


def test_memory_is_bounded_when_no_pose_ever_comes() -> None:
    aligner = FacadeAligner([SIDE], stabilise=False)
    empty = np.empty(0)
    for i in range(3000):
        stamp = START_NS + i * 100_000_000              # 300 s
        aligner.add_scan(0, Scan(stamp, np.ones(1), np.zeros(1), np.zeros(1)) if i % 2 else
                         Scan(stamp, empty, empty, empty))
        assert len(aligner.take_points()) == 0
    assert len(aligner._waiting) <= push_broom.MAX_WAIT / 0.1 + 2
    aligner.finish()
    aligner.take_points()
    assert (aligner.counts.outside, len(aligner._waiting)) == (1500, 0)


def test_scans_without_any_return_give_no_points() -> None:
    path = drive(0.2)
    aligner = FacadeAligner([SIDE], stabilise=False)
    aligner.add_poses(path.stamps_ns, path.poses)
    for i, value in enumerate((np.nan, np.inf, -np.inf, 81.0)):
        aligner.add_scan(0, Scan(START_NS + i * TURN_NS, np.full(181, value), ANGLES, TIMES,
                                 range_max=80.0))
    aligner.finish()
    points = aligner.take_points()
    assert (points.xyz.dtype, points.intensity.dtype) == (np.float64, np.float32)
    assert (points.stamps_ns.dtype, points.ring.dtype) == (np.int64, np.uint16)
    assert (len(points), aligner.counts.no_return, aligner.counts.outside) == (0, 4 * 181, 0)


def test_intensity_is_passed_on_and_zero_where_there_is_none() -> None:
    path = drive(0.2)
    aligner = FacadeAligner([SIDE, FORE], stabilise=False)
    aligner.add_poses(path.stamps_ns, path.poses)
    bright, dark = noise_scan(START_NS, 5), noise_scan(START_NS, 6)
    aligner.add_scan(0, bright)
    aligner.add_scan(1, Scan(START_NS, dark.ranges, ANGLES, TIMES, None, range_max=80.0))
    points = aligner.take_points()
    assert bright.intensities is not None
    np.testing.assert_array_equal(points.intensity[points.ring == 0],
                                  bright.intensities[bright.valid].astype(np.float32))
    assert not points.intensity[points.ring == 1].any()


def test_before_alignment_points_ride_on_the_straight_drive() -> None:
    path = drive(2.0)
    rng = np.random.default_rng(7)
    base = rng.uniform(-10.0, 10.0, (500, 3))
    stamps = rng.integers(path.stamps_ns[0], path.stamps_ns[-1], 500)
    before = at_constant_speed(from_base(path.at(stamps), base), stamps, path)
    np.testing.assert_allclose(before, from_base(constant_speed(path).at(stamps), base), atol=1e-9)
    straight = constant_speed(path)
    xyz = from_base(straight.at(stamps), base)
    np.testing.assert_allclose(at_constant_speed(xyz, stamps, straight), xyz, atol=1e-9)
    outside = at_constant_speed(xyz[:1], [path.stamps_ns[0] - 1], path)
    assert np.all(np.isnan(outside))
