# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The player: every byte of the bag, in order, to whoever was there, however slow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import time

import live
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import get_typestore, Stores

from stri_mapping.bag_io import Bag, LASER_SCAN

pytestmark = [live.needs_ros, pytest.mark.skipif(
    not live.CAMPUS.is_dir(), reason=f'{live.CAMPUS} is not there')]

TOPICS = ('/horizontal/scan', '/vertical_side/scan')


@pytest.fixture(scope='module')
def bag_path(tmp_path_factory) -> Path:
    return live.cut_bag(live.CAMPUS, tmp_path_factory.mktemp('bags') / 'short', 4.0)


@pytest.fixture
def listener():
    with live.listener() as parts:
        yield parts


def test_at_full_speed_a_slow_subscriber_still_gets_every_byte_in_order(listener, bag_path):
    from sensor_msgs.msg import LaserScan
    node, executor, env = listener
    got: dict[str, list[bytes]] = {topic: [] for topic in TOPICS}

    def take(topic: str):
        def callback(data: bytes) -> None:
            time.sleep(0.002)           # slower than the player by far
            got[topic].append(bytes(data))
        return callback

    for topic in TOPICS:
        node.create_subscription(LaserScan, topic, take(topic), live.lossless(), raw=True)
    with Bag(bag_path) as bag:
        sent = {topic: [bytes(data) for _, _, data in bag.raw_messages([topic])]
                for topic in TOPICS}
    parameters = {'bag': bag_path, 'rate': 0.0, 'subscribers': ' '.join(TOPICS)}
    with live.node('bag_player', parameters, env) as player:
        live.spin_until(executor, lambda: all(
            len(got[topic]) >= len(sent[topic]) for topic in TOPICS), 'all scans')
        output, _ = player.communicate(timeout=live.TIMEOUT)
    assert player.returncode == 0, output
    assert got == sent
    assert f'{len(sent[TOPICS[0]])} {TOPICS[0]}' in output
    assert 'Traceback' not in output


def test_a_ros_1_bag_is_played_as_ros_2(listener, tmp_path):
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import LaserScan
    node, executor, env = listener
    old, new = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
    with Bag(live.CAMPUS) as bag, Writer(tmp_path / 'old.bag') as out:
        scans = [bytes(data) for _, _, data in bag.raw_messages([TOPICS[0]])][:20]
        connection = out.add_connection('/scan', LASER_SCAN, typestore=old)
        for number, data in enumerate(scans):
            scan = new.deserialize_cdr(data, LASER_SCAN)
            header = old.types['std_msgs/msg/Header'](
                seq=number, stamp=scan.header.stamp, frame_id=scan.header.frame_id)
            out.write(connection, number, old.serialize_ros1(
                replace(scan, header=header), LASER_SCAN))
    got: list[LaserScan] = []
    node.create_subscription(LaserScan, '/scan', got.append, live.lossless())
    parameters = {'bag': tmp_path / 'old.bag', 'rate': 0.0, 'subscribers': '/scan'}
    with live.node('bag_player', parameters, env) as player:
        live.spin_until(executor, lambda: len(got) == len(scans), 'all scans')
        assert player.wait(live.TIMEOUT) == 0
    assert got == [deserialize_message(data, LaserScan) for data in scans]


def test_the_command_plays_a_bag(bag_path):
    code, output = live.shown(['play', bag_path, '--rate', 0], live.environment())
    assert code == 0, output
    with Bag(bag_path) as bag:
        for topic in TOPICS:
            assert f'{bag.message_count(topic)} {topic}' in output
    code, output = live.shown(['play', 'nowhere'], live.environment())
    assert (code, output.count('\n')) == (1, 1)


def test_a_misspelt_parameter_is_said(bag_path):
    parameters = {'bag': bag_path, 'rate': 0.0, 'subscriber': TOPICS[0]}
    with live.node('bag_player', parameters, live.environment()) as player:
        output, _ = player.communicate(timeout=live.TIMEOUT)
    assert player.returncode == 0
    assert 'parameter subscriber is unknown' in output


def test_the_clock_goes_with_the_messages(listener, bag_path):
    from rclpy.qos import qos_profile_sensor_data
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import LaserScan
    node, executor, env = listener
    stamps: list[int] = []
    node.create_subscription(
        Clock, '/clock', lambda m: stamps.append(m.clock.sec * 10**9 + m.clock.nanosec),
        qos_profile_sensor_data)
    node.create_subscription(LaserScan, TOPICS[0], lambda data: None, live.lossless(), raw=True)
    with Bag(bag_path) as bag:
        logged = [log_ns for _, log_ns, _ in bag.raw_messages()]
    parameters = {'bag': bag_path, 'rate': 1.0, 'subscribers': TOPICS[0]}
    with live.node('bag_player', parameters, env) as player:
        live.spin_until(executor, lambda: player.poll() is not None, 'the end')
        for _ in range(20):
            executor.spin_once(timeout_sec=0.05)
    assert player.returncode == 0
    assert stamps                       # those before the connection are lost, as with any clock
    assert stamps == sorted(stamps)
    assert set(stamps) <= set(logged)


def test_without_the_subscribers_it_was_told_of_it_says_which_and_fails(bag_path):
    parameters = {'bag': bag_path, 'subscribers': TOPICS[0], 'patience': 0.5}
    with live.node('bag_player', parameters, live.environment()) as player:
        output, _ = player.communicate(timeout=live.TIMEOUT)
    assert player.returncode == 1
    assert f'{TOPICS[0]}: nobody subscribed within' in output
    assert 'Traceback' not in output


@pytest.mark.parametrize('parameters, code, said', [
    ({}, 2, 'parameter bag'),
    ({'bag': '/nowhere'}, 1, '/nowhere: no such file or directory'),
    ({'bag': 'x', 'rate': -1.0}, 2, 'parameter rate'),
    ({'bag': 'x', 'rate': 'fast'}, 2, 'parameter rate'),
    ({'bag': 'x', 'rate': 1}, 2, 'want a value such as 1.0'),
    ({'bag': live.CAMPUS, 'subscribers': '/other'}, 2, '/other is not played'),
    ({'bag': live.CAMPUS, 'topics': '/other'}, 1, 'no topic /other; topics there: /ground_truth'),
])
def test_what_it_cannot_use_is_said_in_one_line(parameters, code, said):
    with live.node('bag_player', parameters, live.environment()) as player:
        output, _ = player.communicate(timeout=live.TIMEOUT)
    assert player.returncode == code, output
    assert said in output
    assert 'Traceback' not in output
