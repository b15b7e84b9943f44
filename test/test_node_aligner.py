# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The aligner node alone: the points of the core, once each, however late it comes."""

from __future__ import annotations

from array import array
import gc
import os
from pathlib import Path as FilePath
import signal
import subprocess
from typing import Any

import live
import numpy as np

from stri_mapping.facade.cloud_files import count_points, read_ply
from stri_mapping.facade.journal import JOURNAL_NAMES, SCAN, whole_records
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.scan import Scan, scan_from_message, stamp_ns
from stri_mapping.stri.estimate import Estimate
from stri_mapping.summary import read_summary
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

pytestmark = live.needs_ros

T0, PERIOD = 1_767_225_600_000_000_000, 13_320_000
SCANS = 400


def estimates() -> list[Estimate]:
    """Return a gentle left turn at 5 m/s, one pose a scan period."""
    moments = np.arange(SCANS + 2) * PERIOD * 1e-9
    return [Estimate(T0 + i * PERIOD, np.array([5.0 * t, 0.1 * t * t, 0.04 * t]), np.eye(3),
                     np.zeros(3), np.eye(3), 1.0, False) for i, t in enumerate(moments)]


def messages() -> list:
    """Return the scans of a vertical scanner: a wall 8 m away, every tenth ray without return."""
    from sensor_msgs.msg import LaserScan
    found = []
    for i in range(SCANS):
        ranges = np.full(181, 8.0, np.float32)
        ranges[::10] = np.inf
        scan = LaserScan(
            angle_min=0.0, angle_max=np.pi, angle_increment=float(np.deg2rad(1.0)),
            time_increment=0.01332 / 360, scan_time=0.01332, range_max=80.0,
            ranges=array('f', ranges.tobytes()))
        scan.header.stamp.sec, scan.header.stamp.nanosec = divmod(T0 + i * PERIOD, 10**9)
        found.append(scan)
    return found


def offline() -> np.ndarray:
    """Return the points (n, 3) that the core makes of the same input."""
    aligner = FacadeAligner(load_vehicle(default_vehicle_file()).verticals)
    for message in messages():
        aligner.add_scan(1, scan_from_message(message))
    aligner.add_poses([e.stamp_ns for e in estimates()], [e.pose for e in estimates()])
    aligner.finish()
    return aligner.take_points().xyz


def end(process: subprocess.Popen[str], executor: Any) -> None:
    """Stop the aligner, take what it still publishes, and see that it ended well."""
    process.send_signal(signal.SIGTERM)
    live.spin_until(executor, lambda: process.poll() is not None, 'the end')
    for _ in range(10):
        executor.spin_once(timeout_sec=0.05)
    output, _ = process.communicate()
    assert process.returncode == 0, output


def test_points_are_those_of_the_core_though_the_path_was_there_first(tmp_path):
    from nav_msgs.msg import Path
    from sensor_msgs.msg import LaserScan, PointCloud2

    from stri_mapping.nodes.conversions import path_message, POINT
    clouds: list[PointCloud2] = []
    maps: list[PointCloud2] = []
    with live.listener() as (own, executor, env):
        path = own.create_publisher(Path, 'trajectory', live.latched())
        scans = own.create_publisher(LaserScan, 'vertical_side/scan', live.lossless())
        own.create_subscription(PointCloud2, 'facade/points', clouds.append, live.lossless())
        for first in range(0, SCANS // 2, 10):          # nobody is there yet
            path.publish(path_message(estimates()[first:first + 10], 'odom'))
        with live.node('facade_aligner', {'output': tmp_path}, env) as process:
            live.spin_until(executor, lambda: scans.get_subscription_count()
                            and path.get_subscription_count()
                            and own.count_publishers('facade/points'), 'the aligner')
            for message in messages():
                scans.publish(message)
            path.publish(path_message(estimates()[first + 10:], 'odom'))
            live.spin_until(executor, lambda: clouds, 'points')
            own.create_subscription(PointCloud2, 'facade/map', maps.append, live.latched())
            live.spin_until(executor, lambda: maps, 'the map')
            end(process, executor)
    records = np.concatenate([np.frombuffer(m.data, POINT) for m in clouds])
    expected = offline()
    assert len(records) == len(expected) == count_points(tmp_path / 'facade.ply')
    got = np.stack([records[axis] for axis in 'xyz'], axis=1)
    order, wanted = (np.lexsort(np.round(xyz, 3).T) for xyz in (got, expected))
    # float32 at some 20 m: steps of 2e-6 m
    np.testing.assert_allclose(got[order], expected[wanted], atol=2e-3)
    assert set(records['ring']) == {1}
    assert {m.header.frame_id for m in clouds} == {'odom'}
    times = np.concatenate([stamp_ns(m.header.stamp) - T0 + 1e9 * np.frombuffer(
        m.data, POINT)['time'].astype(float) for m in clouds])
    assert times.min() >= 0.0
    assert times.max() <= SCANS * PERIOD
    assert 0 < maps[-1].width <= len(records)
    assert read_summary(tmp_path)['rays_without_return'] == 19 * SCANS


def test_without_a_path_it_ends_cleanly_without_points(tmp_path):
    with live.listener() as (own, executor, env), live.node(
            'facade_aligner', {'output': tmp_path}, env) as process:
        live.spin_until(executor, lambda: own.count_subscribers('trajectory'), 'the aligner')
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=live.TIMEOUT)
    assert process.returncode == 0, output
    assert 'Traceback' not in output
    assert not (tmp_path / 'facade.ply').exists()


class Feeder:
    """Publishes scans and the path, and hears the points, while aligners come and go."""

    def __init__(self, own: Any) -> None:
        from nav_msgs.msg import Path
        from rclpy.event_handler import PublisherEventCallbacks
        from sensor_msgs.msg import LaserScan, PointCloud2
        self.readers = 0                        # aligners that have ever read scans
        self.clouds: list[PointCloud2] = []
        self._path = own.create_publisher(Path, 'trajectory', live.latched())
        self._scans = own.create_publisher(
            LaserScan, 'vertical_side/scan', live.lossless(),
            event_callbacks=PublisherEventCallbacks(matched=self._count))
        own.create_subscription(PointCloud2, 'facade/points', self.clouds.append, live.lossless())

    def _count(self, status: Any) -> None:
        self.readers = status.total_count

    def scans(self, begin: int, end: int) -> None:
        for message in messages()[begin:end]:
            self._scans.publish(message)

    def path(self, begin: int, end: int) -> None:
        from stri_mapping.nodes.conversions import path_message
        for first in range(begin, end, 10):
            self._path.publish(path_message(estimates()[first:min(first + 10, end)], 'odom'))

    def rays(self) -> np.ndarray:
        """Return the number of each ray of the drive that was heard."""
        from stri_mapping.nodes.conversions import POINT
        return np.concatenate([np.empty(0, int), *(numbered(
            stamp_ns(m.header.stamp) - T0 + 1e9 * np.frombuffer(m.data, POINT)['time'].astype(
                float)) for m in self.clouds)])


def numbered(since_ns: np.ndarray) -> np.ndarray:
    """Return the numbers of rays, 360 of them a turn, from their times."""
    return np.rint(since_ns * 360 / PERIOD).astype(int)


def in_cloud(folder: FilePath) -> np.ndarray:
    if not (folder / 'facade.ply').is_file():
        return np.empty(0, int)
    return np.concatenate([np.empty(0, int), *(numbered(1e9 * (rows['time'] - 1e-9 * T0))
                                               for rows in read_ply(folder / 'facade.ply'))])


def rays_of(*scans: int) -> np.ndarray:
    """Return the numbers of the rays of some scans that hit the wall."""
    hit = np.flatnonzero(np.arange(181) % 10)
    return (360 * np.array(scans)[:, None] + hit).ravel()


def journalled(folder: FilePath) -> int:
    """Return how many scans are kept for the next aligner."""
    return sum(r.kind == SCAN for name in JOURNAL_NAMES if (folder / name).is_file()
               for r in whole_records((folder / name).read_bytes())[0])


def test_kill_9_costs_no_scan_that_has_come_and_doubles_no_point(tmp_path):
    with live.listener() as (own, executor, env):
        feeder = Feeder(own)
        with live.node('facade_aligner', {'output': tmp_path}, env) as process:
            live.spin_until(executor, lambda: feeder.readers == 1, 'the aligner')
            feeder.scans(0, 200)
            feeder.path(0, 150)
            live.spin_until(executor, lambda: journalled(tmp_path) == 200 and feeder.clouds,
                            'points of the first scans, and the others in the journal')
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
        before = in_cloud(tmp_path)
        assert 0 < len(before) < len(rays_of(*range(150)))
        feeder.scans(200, 220)                  # nobody reads them
        feeder.path(150, 250)
        with live.node('facade_aligner', {'output': tmp_path, 'resume': True}, env) as process:
            live.spin_until(executor, lambda: feeder.readers == 2, 'the next aligner')
            feeder.scans(220, SCANS)
            feeder.path(250, SCANS + 2)
            live.spin_until(executor, lambda: len(in_cloud(tmp_path)) > len(before), 'more points')
            end(process, executor)
    expected = rays_of(*range(200), *range(220, SCANS))
    np.testing.assert_array_equal(in_cloud(tmp_path), expected)
    heard = feeder.rays()
    assert len(np.unique(heard)) == len(heard)
    assert np.isin(heard, expected).all()
    assert np.isin(np.setdiff1d(expected, before), heard).all()
    summary = read_summary(tmp_path)
    assert summary['points'] == len(expected)
    assert summary['rays_without_return'] == 19 * (SCANS - 20)
    assert summary['rays_without_pose'] == 0
    side, = (s for s in summary['scanners'] if s['name'] == 'vertical_side')
    assert (side['scans'], side['lost_scans']) == (SCANS - 20, 20)
    assert not any((tmp_path / name).exists() for name in JOURNAL_NAMES)


def test_what_waited_when_it_was_killed_stays_in_its_own_drive_when_time_is_set_back(tmp_path):
    with live.listener() as (own, executor, env):
        feeder = Feeder(own)
        with live.node('facade_aligner', {'output': tmp_path}, env) as process:
            live.spin_until(executor, lambda: feeder.readers == 1, 'the aligner')
            feeder.scans(0, SCANS)
            feeder.path(0, 250)
            log = tmp_path / 'scans_vertical_side.log'      # 32 bytes, and 8 for each scan
            live.spin_until(executor, lambda: log.stat().st_size == 32 + 8 * SCANS
                            and feeder.clouds, 'points of the first scans, and all scans noted')
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
        feeder.path(250, SCANS + 2)
        feeder.path(0, 10)                      # the bag has begun again
        with live.node('facade_aligner', {'output': tmp_path, 'resume': True}, env) as process:
            live.spin_until(executor, lambda: feeder.readers == 2, 'the next aligner')
            live.spin_until(executor, lambda: read_summary(tmp_path), 'the end of the first drive')
            first = len(feeder.rays())
            feeder.scans(0, SCANS)
            feeder.path(10, SCANS + 2)
            live.spin_until(executor, lambda: len(feeder.rays()) > first + 1000,
                            'points of the second drive')
            process.send_signal(signal.SIGTERM)
            live.spin_until(executor, lambda: process.poll() is not None, 'the end')
            output, _ = process.communicate()
    assert process.returncode == 0, output
    np.testing.assert_array_equal(in_cloud(tmp_path), rays_of(*range(SCANS)))


def scans_alive() -> int:
    """Return how many scans this process holds, whoever holds them."""
    gc.collect()
    return sum(isinstance(each, Scan) for each in gc.get_objects())


def test_scans_that_waited_for_a_new_path_are_placed_once_and_forgotten():
    import rclpy
    from rclpy.serialization import serialize_message

    from stri_mapping.nodes.conversions import path_message
    from stri_mapping.nodes.facade_aligner import FacadeAlignerNode
    rclpy.init(args=['--ros-args', '-p', 'tf_static_wait:=0.0'],
               domain_id=int(live.environment()['ROS_DOMAIN_ID']))
    try:
        aligner = FacadeAlignerNode()
        scans = [serialize_message(scan) for scan in messages()[:100]]
        path = serialize_message(path_message(estimates()[:110], 'odom'))
        before = scans_alive()
        for _ in range(4):                  # in all but the first, scans come before their path
            for scan in scans:
                aligner.inputs[1]._take(scan)
            aligner._take_path(path)
            assert scans_alive() <= before
            assert aligner._aligner.counts.scans == len(scans)
            assert aligner._aligner.counts.out_of_order == 0
        aligner.node.destroy_node()
    finally:
        rclpy.shutdown()
