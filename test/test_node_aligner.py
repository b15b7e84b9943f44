# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The aligner node alone: the points of the core, once each, however late it comes."""

from __future__ import annotations

from array import array
import gc
import signal

import live
import numpy as np

from stri_mapping.facade.cloud_files import count_points
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
            process.send_signal(signal.SIGTERM)
            live.spin_until(executor, lambda: process.poll() is not None, 'the end')
            for _ in range(10):
                executor.spin_once(timeout_sec=0.05)
            output, _ = process.communicate()
    assert process.returncode == 0, output
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


def scans_alive() -> int:
    """Return how many scans this process holds, whoever holds them."""
    gc.collect()
    return sum(isinstance(each, Scan) for each in gc.get_objects())


def test_scans_that_waited_for_a_new_path_are_placed_once_and_forgotten():
    import rclpy

    from stri_mapping.nodes.conversions import path_message
    from stri_mapping.nodes.facade_aligner import FacadeAlignerNode
    rclpy.init(args=['--ros-args', '-p', 'tf_static_wait:=0.0'],
               domain_id=int(live.environment()['ROS_DOMAIN_ID']))
    try:
        aligner = FacadeAlignerNode()
        scans, path = messages()[:100], path_message(estimates()[:110], 'odom')
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
