# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Every kind of bag gives the same scans, mounts and truth."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import get_typestore, Stores

from stri_mapping.bag_io import Bag, select_scanners
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

CAMPUS = Path(__file__).parents[1] / 'bags' / 'campus'
TOPICS = ('/horizontal/scan', '/vertical_side/scan', '/tf_static', '/ground_truth/odom')
MESSAGES = 400


@pytest.fixture(scope='module')
def messages():
    with AnyReader([CAMPUS]) as reader:
        chosen = [c for c in reader.connections if c.topic in TOPICS]
        found = []
        for connection, stamp, data in reader.messages(chosen):
            found.append((connection.topic, connection.msgtype, stamp,
                          reader.deserialize(data, connection.msgtype)))
            if len(found) == MESSAGES:
                return found


def write_ros2(path, messages, plugin, compression=None):
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Ros2Writer(path, version=9, storage_plugin=plugin)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, kind, stamp, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], stamp, store.serialize_cdr(message, kind))
    return path


def write_ros1(path, messages):
    """Write what ROS 1 knows: its headers carry a sequence number besides."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = 'sensor_msgs/msg/LaserScan'
    Header, Scan = store.types['std_msgs/msg/Header'], store.types[kind]
    Time = store.types['builtin_interfaces/msg/Time']
    with Ros1Writer(path) as writer:
        connection = writer.add_connection('/horizontal/scan', kind, typestore=store)
        for topic, _, stamp, m in messages:
            if topic == '/horizontal/scan':
                header = Header(0, Time(m.header.stamp.sec, m.header.stamp.nanosec),
                                m.header.frame_id)
                scan = Scan(header, m.angle_min, m.angle_max, m.angle_increment,
                            m.time_increment, m.scan_time, m.range_min, m.range_max, m.ranges,
                            m.intensities)
                writer.write(connection, stamp, store.serialize_ros1(scan, kind))
    return path


def single_mcap(path, messages):
    folder = write_ros2(path, messages, StoragePlugin.MCAP)
    return next(folder.glob('*.mcap'))


KINDS = {
    'mcap': lambda p, m: write_ros2(p, m, StoragePlugin.MCAP),
    'mcap file': single_mcap,
    'sqlite': lambda p, m: write_ros2(p, m, StoragePlugin.SQLITE3),
    'sqlite, messages compressed':
        lambda p, m: write_ros2(p, m, StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    'sqlite, file compressed':
        lambda p, m: write_ros2(p, m, StoragePlugin.SQLITE3, CompressionMode.FILE),
    'ros 1': lambda p, m: write_ros1(p.with_suffix('.bag'), m),
}


def horizontal_scans(path):
    with Bag(path) as bag:
        vehicle = select_scanners(bag, load_vehicle(default_vehicle_file()))
        return [scan for _, scan in bag.scans([vehicle.horizontal])]


@pytest.mark.parametrize('kind', KINDS)
def test_every_kind_of_bag_gives_the_same_scans(tmp_path, messages, kind):
    read = horizontal_scans(KINDS[kind](tmp_path / 'bag', messages))
    expected = horizontal_scans(CAMPUS)[:len(read)]
    assert len(read) == sum(topic == '/horizontal/scan' for topic, *_ in messages) > 80
    assert [s.stamp_ns for s in read] == [s.stamp_ns for s in expected]
    for one, other in zip(read, expected):
        np.testing.assert_array_equal(one.ranges, other.ranges)
        np.testing.assert_array_equal(one.times, other.times)


def test_truth_and_mounts_are_read(tmp_path, messages):
    path = write_ros2(tmp_path / 'bag', messages, StoragePlugin.MCAP)
    with Bag(path) as bag:
        truth = bag.odometry('/ground_truth/odom')
        mounts = bag.static_transforms()
    assert len(truth) == sum(topic == '/ground_truth/odom' for topic, *_ in messages)
    assert truth.poses[-1, 0] > 5.0
    vehicle = load_vehicle(default_vehicle_file())
    for scanner in vehicle.scanners:
        np.testing.assert_allclose(mounts['base_link', scanner.frame], scanner.T_base_laser,
                                   atol=1e-9)
