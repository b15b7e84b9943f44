# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator node alone: its topics, its start, its end, its answer to any publisher."""

from __future__ import annotations

import signal

import live
import numpy as np
import pytest

from stri_mapping.bag_io import Bag
from stri_mapping.scan import stamp_ns
from stri_mapping.summary import read_summary
from stri_mapping.trajectory import read_tum

pytestmark = [live.needs_ros, pytest.mark.skipif(
    not live.CAMPUS.is_dir(), reason=f'{live.CAMPUS} is not there')]

TOPIC = '/horizontal/scan'
SCANS = 330                             # some four seconds
SOON = {'tf_static_wait': 0.0}


@pytest.fixture(scope='module')
def drive() -> list[bytes]:
    with Bag(live.CAMPUS) as bag:
        return [bytes(data) for _, _, data in bag.raw_messages([TOPIC])]


@pytest.fixture(scope='module')
def scans(drive) -> list[bytes]:
    return drive[:SCANS]


def ended(process) -> str:
    """Stop a node as by Ctrl-C; return its output, having required a clean end."""
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=live.TIMEOUT)
    assert process.returncode == 0, output
    assert 'Traceback' not in output
    return output


def test_topics_carry_one_odometry_a_scan_and_every_final_pose_once(scans, tmp_path):
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import TwistWithCovarianceStamped
    from nav_msgs.msg import Odometry, Path
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import Image, LaserScan
    kinds = {'odom': Odometry, 'velocity': TwistWithCovarianceStamped, 'trajectory': Path,
             'stri/image': Image, 'stri/segments': Image, '/diagnostics': DiagnosticArray}
    got: dict[str, list] = {topic: [] for topic in kinds}
    with live.listener() as (own, executor, env):
        for topic, kind in kinds.items():
            # the path's publisher keeps what it gave before it knew of this subscription
            own.create_subscription(kind, topic, got[topic].append,
                                    live.latched() if kind is Path else live.lossless())
        publisher = own.create_publisher(LaserScan, TOPIC, live.lossless())
        with live.node('stri_estimator', {'output': tmp_path, **SOON}, env) as process:
            live.spin_until(executor, publisher.get_subscription_count, 'the estimator')
            live.spin_until(executor, lambda: all(
                own.count_publishers(topic) for topic in kinds), 'its topics')
            for data in scans:
                publisher.publish(data)
            stamps = [stamp_ns(deserialize_message(data, LaserScan).header.stamp)
                      for data in scans]
            live.spin_until(executor, lambda: got['odom'] and stamp_ns(
                got['odom'][-1].header.stamp) == stamps[-1], 'the last odometry')
            live.spin_until(executor, lambda: got['stri/segments'] and got['/diagnostics'],
                            'pictures and diagnostics')
            late: list[Path] = []       # who comes late gets the whole path all the same
            own.create_subscription(Path, 'trajectory', late.append, live.latched())
            live.spin_until(executor, lambda: late and late[-1] == got['trajectory'][-1],
                            'the path for a late subscriber')
            process.send_signal(signal.SIGINT)
            live.spin_until(executor, lambda: stamp_ns(
                got['trajectory'][-1].header.stamp) == stamps[-1], 'the last pose')
            output, _ = process.communicate(timeout=live.TIMEOUT)
            assert process.returncode == 0, output
    odometry = [stamp_ns(m.header.stamp) for m in got['odom']]
    assert odometry == stamps[-len(odometry):]          # every scan, once it has started
    velocities = [stamp_ns(m.header.stamp) for m in got['velocity']]
    assert velocities == stamps[-len(velocities):]
    assert min(len(odometry), len(velocities)) > SCANS // 3     # a start takes 1.3 s of scans
    assert {(m.header.frame_id, m.child_frame_id) for m in got['odom']} == {('odom', 'base_link')}
    covariances = np.array([m.pose.covariance for m in got['odom']]).reshape(-1, 6, 6)
    assert np.all(np.linalg.eigvalsh(covariances) > -1e-12)
    poses = [pose for message in got['trajectory'] for pose in message.poses]
    assert [stamp_ns(p.header.stamp) for p in poses] == stamps
    for message in got['trajectory']:
        assert message.header.stamp == message.poses[-1].header.stamp
    path = read_tum(tmp_path / 'trajectory.tum')
    np.testing.assert_allclose([(p.pose.position.x, p.pose.position.y) for p in poses],
                               path.poses[:, :2], atol=1e-9)     # the file has nine decimals
    assert late == got['trajectory'][:len(late)]
    assert read_summary(tmp_path)['scans'] == SCANS
    picture = got['stri/segments'][-1]
    assert (picture.encoding, picture.height > 1, picture.width) == ('rgb8', True, 181)
    assert got['stri/image'][-1].encoding == 'mono8'
    statuses = [status for message in got['/diagnostics'] for status in message.status]
    assert {status.name for status in statuses} == {'stri_estimator: motion'}
    if live.find_spec('tf2_msgs') is None:
        assert output.count('tf2_msgs is not installed') == 1


def test_a_best_effort_publisher_is_heard_too(drive):
    from nav_msgs.msg import Odometry
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import LaserScan
    odometry: list[Odometry] = []
    with live.listener() as (own, executor, env):
        own.create_subscription(Odometry, 'odom', odometry.append, live.lossless())
        publisher = own.create_publisher(LaserScan, TOPIC, qos_profile_sensor_data)
        with live.node('stri_estimator', SOON, env) as process:
            live.spin_until(executor, publisher.get_subscription_count, 'the estimator')
            waiting = iter(drive)       # on a busy machine many of them get lost

            def another() -> bool:
                publisher.publish(next(waiting))
                return len(odometry) > 20

            live.spin_until(executor, another, 'odometry')
            assert 'offers best effort only' in ended(process)


def test_without_scans_it_ends_cleanly_and_leaves_an_empty_path(tmp_path):
    with live.listener() as (own, executor, env), live.node(
            'stri_estimator', {'output': tmp_path, **SOON}, env) as process:
        live.spin_until(executor, lambda: own.count_subscribers(TOPIC), 'the estimator')
        ended(process)
    assert len(read_tum(tmp_path / 'trajectory.tum')) == 0
    assert read_summary(tmp_path)['scans'] == 0


def test_quality_of_service_can_be_overridden(scans):
    from nav_msgs.msg import Odometry
    from rclpy.qos import ReliabilityPolicy
    with live.listener() as (own, executor, env):
        own.create_subscription(Odometry, 'odom', lambda _: None, 10)
        overrides = {f'qos_overrides./odom.publisher.{policy}': value for policy, value in (
            ('reliability', 'best_effort'), ('depth', 3))}
        with live.node('stri_estimator', {**SOON, **overrides}, env) as process:
            live.spin_until(executor, lambda: all(
                own.get_publishers_info_by_topic(topic) for topic in ('/odom', '/velocity')),
                'its topics')
            offered = {topic: own.get_publishers_info_by_topic(topic)[0].qos_profile.reliability
                       for topic in ('/odom', '/velocity')}
            assert 'unknown' not in ended(process)
    assert offered == {'/odom': ReliabilityPolicy.BEST_EFFORT,
                       '/velocity': ReliabilityPolicy.RELIABLE}     # each endpoint for itself


@pytest.mark.parametrize('parameters, code, said', [
    ({'qos_overrides./odom.publisher.reliability': 'maybe'}, 2, 'quality of service of odom'),
    ({'qos_overrides./odom.publisher.depth': 'many'}, 2, 'quality of service of odom'),
    ({'vehicle_file': '/nowhere.yaml'}, 1, '/nowhere.yaml: No such file'),
    ({'odom_frame': 3}, 2, "parameter odom_frame: want a value such as 'odom'"),
    ({'output': '/dev/null/results'}, 2, 'parameter output: /dev/null/results'),
])
def test_what_it_cannot_use_is_said_in_one_line(parameters, code, said):
    with live.node('stri_estimator', {**SOON, **parameters}, live.environment()) as process:
        output, _ = process.communicate(timeout=live.TIMEOUT)
    assert process.returncode == code, output
    assert said in output
    assert 'Traceback' not in output
