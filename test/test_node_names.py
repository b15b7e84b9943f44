# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Names and neighbours: namespaces, remapping, and a DDS of another make on the same topics."""

from __future__ import annotations

import signal

import live
import numpy as np
import pytest

from stri_mapping.bag_io import Bag
from stri_mapping.scan import stamp_ns

pytestmark = [live.needs_ros, pytest.mark.skipif(
    not live.CAMPUS.is_dir(), reason=f'{live.CAMPUS} is not there')]


def scans(count: int) -> list[bytes]:
    with Bag(live.CAMPUS) as bag:
        found = [bytes(data) for _, _, data in bag.raw_messages(['/horizontal/scan'])]
    return found[:count]


def test_a_namespace_and_a_remapping_are_honoured():
    from diagnostic_msgs.msg import DiagnosticArray
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import LaserScan
    odometry: list[Odometry] = []
    said: list[DiagnosticArray] = []
    rules = ['-r', '__ns:=/car', '-r', 'odom:=wheel_less/odom', '-r', 'horizontal/scan:=/front']
    with live.listener() as (own, executor, env):
        own.create_subscription(Odometry, '/car/wheel_less/odom', odometry.append, live.lossless())
        own.create_subscription(DiagnosticArray, '/diagnostics', said.append, live.lossless())
        publisher = own.create_publisher(LaserScan, '/front', live.lossless())
        with live.node('stri_estimator', {'tf_static_wait': 0.0}, env, *rules) as process:
            live.spin_until(executor, publisher.get_subscription_count, 'the estimator')
            waiting = iter(scans(300))

            def another() -> object:
                publisher.publish(next(waiting))
                return odometry

            live.spin_until(executor, another, 'odometry')
            live.spin_until(executor, lambda: said, 'diagnostics')
            process.send_signal(signal.SIGINT)
            live.spin_until(executor, lambda: process.poll() is not None, 'the end')
            assert process.returncode == 0
    assert said[-1].status[0].name == 'car/stri_estimator: motion'


def test_another_make_of_dds_hears_scans_odometry_and_points(tmp_path):
    other = pytest.importorskip('other_dds', reason='pip install cyclonedds')
    short = live.cut_bag(live.CAMPUS, tmp_path / 'short', 4.0)
    env = live.environment()
    with Bag(short) as bag:
        stamps = [stamp_ns(message.header.stamp)
                  for _, _, message in bag.messages(['/horizontal/scan'])]
        ranges = np.concatenate([message.ranges for _, _, message in bag.messages(
            ['/horizontal/scan'])])
    given = {'output': tmp_path / 'out', 'tf_static_wait': 0.0}
    player = {'bag': short, 'rate': 2.0, 'follow': 'odom',
              'subscribers': '/horizontal/scan /horizontal/scan /vertical_side/scan'}
    with other.Listener(int(env['ROS_DOMAIN_ID'])) as listener, live.node(
            'stri_estimator', given, env) as estimator, live.node(
            'facade_aligner', given, env) as aligner:
        live.wait_until(lambda: listener.matched('odom') and listener.matched('facade/points'),
                        'the nodes')
        with live.node('bag_player', player, env) as process:
            live.wait_until(lambda: listener.take() or process.poll() is not None, 'the end')
        for each in (estimator, aligner):
            each.send_signal(signal.SIGINT)
            live.wait_until(lambda p=each: listener.take() or p.poll() is not None, 'its end')
            assert each.returncode == 0, each.communicate()[0]
        listener.take()
    assert [stamp_ns(scan.header.stamp) for scan in listener.scans] == stamps
    np.testing.assert_array_equal(np.concatenate([scan.ranges for scan in listener.scans]), ranges)
    odometry = [stamp_ns(message.header.stamp) for message in listener.odometry]
    assert odometry == stamps[-len(odometry):]
    assert {(m.header.frame_id, m.child_frame_id) for m in listener.odometry} == {
        ('odom', 'base_link')}
    points = sum(cloud.width for cloud in listener.clouds)
    assert points == live.point_count(tmp_path / 'out')
    assert {tuple(field.name for field in cloud.fields) for cloud in listener.clouds} == {
        ('x', 'y', 'z', 'intensity', 'time', 'ring')}
