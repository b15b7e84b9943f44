# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the messages say is what the cores said, to the precision of their fields."""

from __future__ import annotations

from dataclasses import dataclass, field
import os

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'

from stri_mapping import geometry
from stri_mapping.facade.points import FacadePoints
from stri_mapping.nodes import conversions, parameters, raw_output
from stri_mapping.stri.config import EstimatorConfig
from stri_mapping.stri.estimate import Estimate

T0 = 1_767_225_600_123_456_789
finite = st.floats(-1e4, 1e4)
yaws = st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=30).map(np.cumsum)


def estimate(pose, stamp=T0, spread=0.01) -> Estimate:
    root = spread * np.arange(1.0, 10.0).reshape(3, 3)
    covariance = root @ root.T
    covariance[0, 2] *= 1.0 + 1e-13                     # symmetric but for rounding
    return Estimate(stamp, np.asarray(pose, dtype=float), covariance,
                    np.array([5.0, 0.1, -0.2]), spread * np.eye(3), 0.9, False)


def facade(n: int) -> FacadePoints:
    rng = np.random.default_rng(n)
    return FacadePoints(
        rng.normal(scale=100.0, size=(n, 3)), rng.random(n).astype(np.float32),
        T0 + rng.integers(0, 10**9, n), rng.integers(0, 3, n).astype(np.uint16),
        np.ones(n, np.uint8))


@given(finite, finite, yaws, finite)
def test_a_path_brings_back_its_poses_and_turns_on_from_the_last_heading(x, y, headings, ahead):
    estimates = [estimate((x, y, yaw), T0 + i) for i, yaw in enumerate(headings)]
    message = conversions.path_message(estimates, 'odom')
    stamps, poses = conversions.poses_from_path(message, yaw=headings[0] + 1.0)
    assert stamps.tolist() == [e.stamp_ns for e in estimates]
    np.testing.assert_array_equal(poses[:, :2], [[x, y]] * len(headings))
    # a quaternion of doubles keeps an angle to some 1e-15, the sum of turns adds its rounding
    np.testing.assert_allclose(poses[:, 2], headings, atol=1e-9)
    assert conversions.stamp_ns(message.header.stamp) == estimates[-1].stamp_ns


def test_an_empty_path_gives_no_poses():
    stamps, poses = conversions.poses_from_path(conversions.path_message([], 'odom'))
    assert stamps.shape == (0,)
    assert poses.shape == (0, 3)


def test_odometry_carries_pose_twist_frames_and_covariances():
    one = estimate((1.0, 2.0, 0.3))
    message = conversions.odometry_message(one, 'odom', 'base_link')
    assert (message.header.frame_id, message.child_frame_id) == ('odom', 'base_link')
    assert conversions.stamp_ns(message.header.stamp) == T0
    q = message.pose.pose.orientation
    assert geometry.yaw_from_quat((q.x, q.y, q.z, q.w)) == pytest.approx(0.3)
    pose = np.reshape(message.pose.covariance, (6, 6))
    planar = [0, 1, 5]
    np.testing.assert_allclose(pose[np.ix_(planar, planar)], one.pose_covariance, rtol=1e-9)
    np.testing.assert_array_equal(pose, pose.T)
    assert pose[2, 2] == pose[3, 3] == pose[4, 4] == conversions.UNOBSERVED
    assert np.count_nonzero(pose) == 9 + 3
    assert message.twist.twist.linear.x == 5.0
    assert message.twist.twist.angular.z == -0.2
    velocity = conversions.velocity_message(one, 'base_link')
    assert velocity.twist == message.twist
    assert velocity.header.frame_id == 'base_link'


def test_the_transform_is_the_odometry():
    one = estimate((1.0, 2.0, 2.5))
    transform = conversions.transform_message(one, 'odom', 'base_link')
    odometry = conversions.odometry_message(one, 'odom', 'base_link')
    assert transform.transform.rotation == odometry.pose.pose.orientation
    assert transform.transform.translation.y == odometry.pose.pose.position.y
    assert transform.header == odometry.header


@pytest.mark.parametrize('n', [0, 1, 4_999, 5_000, 11_000])
def test_clouds_are_cut_into_pieces_that_hold_every_point(n):
    points = facade(n)
    messages = list(conversions.cloud_messages(points, 'odom'))
    assert len(messages) == -(-n // 5_000)
    pieces = []
    for message in messages:
        assert len(message.data) == message.row_step == message.width * message.point_step
        assert len(message.data) < 500_000
        assert message.header.frame_id == 'odom'
        records = np.frombuffer(message.data, dtype=conversions.POINT)
        assert records['time'].min() == 0.0
        pieces.append((records, conversions.stamp_ns(message.header.stamp)))
    if not n:
        return
    records = np.concatenate([r for r, _ in pieces])
    times = np.concatenate([first - T0 + r['time'].astype(float) * 1e9 for r, first in pieces])
    np.testing.assert_array_equal(np.stack([records[a] for a in 'xyz'], axis=1),
                                  points.xyz.astype(np.float32))
    np.testing.assert_array_equal(records['intensity'], points.intensity)
    np.testing.assert_array_equal(records['ring'], points.ring)
    # one second in float32 has steps of 60 ns
    np.testing.assert_allclose(times, points.stamps_ns - T0, atol=100)


def test_the_fields_of_a_point_say_where_its_bytes_are():
    (message,) = conversions.cloud_messages(facade(3), 'odom')
    assert [f.name for f in message.fields] == ['x', 'y', 'z', 'intensity', 'time', 'ring']
    for f in message.fields:
        kind, offset = conversions.POINT.fields[f.name][:2]
        assert offset == f.offset
        assert kind == {f.FLOAT32: np.float32, f.UINT16: np.uint16}[f.datatype]


def test_the_map_is_the_points_alone():
    xyz = facade(10).xyz
    message = conversions.map_message(xyz, T0, 'odom')
    np.testing.assert_array_equal(np.frombuffer(message.data, '<f4').reshape(-1, 3),
                                  xyz.astype(np.float32))
    assert message.point_step == 12


@pytest.mark.parametrize('shape, encoding', [((4, 7), 'mono8'), ((4, 7, 3), 'rgb8')])
def test_pictures_keep_rows_columns_and_colours(shape, encoding):
    picture = np.arange(np.prod(shape), dtype=np.uint8).reshape(shape)
    message = conversions.image_message(picture, T0, 'laser')
    assert (message.height, message.width, message.encoding) == (4, 7, encoding)
    assert message.step * message.height == len(message.data)
    np.testing.assert_array_equal(np.frombuffer(message.data, np.uint8).reshape(shape), picture)


def test_the_stamp_is_read_from_serialised_bytes():
    from rclpy.serialization import serialize_message
    message = conversions.odometry_message(estimate((0.0, 0.0, 0.0)), 'odom', 'base_link')
    assert raw_output.header_stamp_ns(serialize_message(message)) == T0


def test_types_that_are_not_installed_have_no_class():
    assert raw_output.message_class('no_such_msgs/msg/Thing') is None
    assert raw_output.message_class('sensor_msgs/msg/NoSuchThing') is None
    assert raw_output.message_class('sensor_msgs/msg/LaserScan').__name__ == 'LaserScan'


def test_every_parameter_has_a_description():
    for config in (parameters.NodeSettings, EstimatorConfig):
        described = parameters.descriptions(config)
        for name, default in vars(config()).items():
            assert described.get(name), f'{config.__name__}.{name}'
            if hasattr(default, '__dataclass_fields__'):
                assert set(vars(default)) <= set(parameters.descriptions(type(default)))


@dataclass(frozen=True)
class Inner:
    """
    Inner.

    Attributes
    ----------
    gain
        Of the inner part,
        told on two lines.
    low, high
        Limits.

    """

    gain: float = 0.5
    low: float = 0.0
    high: float = 1.0
    steps: tuple[int, ...] = (1, 2)


@dataclass(frozen=True)
class Outer:
    """
    Outer.

    Attributes
    ----------
    name
        What it is called.
    inner
        The inner part.

    """

    name: str = 'x'
    inner: Inner = field(default_factory=Inner)


class FakeNode:
    """Records what is declared; some values are given from outside."""

    def __init__(self, **given) -> None:
        self.given, self.described = given, {}

    def declare_parameter(self, name, default, descriptor):
        self.described[name] = descriptor.description
        assert descriptor.read_only
        return type('Parameter', (), {'value': self.given.get(name, default)})


def test_parameters_come_from_the_dataclass_with_dotted_names_for_what_is_nested():
    node = FakeNode(**{'inner.gain': 2.0, 'inner.steps': [3, 4]})
    assert parameters.declare(node, Outer) == Outer('x', Inner(2.0, steps=(3, 4)))
    assert node.described == {'name': 'What it is called.', 'inner.low': 'Limits.',
                              'inner.gain': 'Of the inner part, told on two lines.',
                              'inner.high': 'Limits.', 'inner.steps': ''}
