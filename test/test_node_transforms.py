# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The tf tree, with stand-ins for tf2_msgs and the node: it is not on every machine."""

from __future__ import annotations

from dataclasses import dataclass
import logging
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from stri_mapping import geometry
from stri_mapping.errors import VehicleError
from stri_mapping.nodes import conversions, transforms
from stri_mapping.nodes.parameters import NodeSettings
from stri_mapping.stri.estimate import Estimate


@dataclass
class TFMessage:
    """Stand-in for tf2_msgs/TFMessage."""

    transforms: list


class FakeNode:
    """Hands latched messages to whoever subscribes, keeps what is published and logged."""

    def __init__(self, latched: list[TFMessage]) -> None:
        self.latched, self.published, self.said = latched, [], []
        self.spun = None

    def create_publisher(self, kind, topic, qos):
        assert kind is TFMessage
        return SimpleNamespace(publish=lambda message: self.published.append((topic, message)))

    def create_subscription(self, kind, topic, callback, qos):
        assert topic == '/tf_static'
        self.spun = lambda: [callback(message) for message in self.latched]

    def destroy_subscription(self, subscription):
        self.spun = None

    def get_logger(self):
        return SimpleNamespace(info=self.said.append)


@pytest.fixture
def tf(monkeypatch):
    module = ModuleType('tf2_msgs.msg')
    module.TFMessage = TFMessage
    monkeypatch.setitem(sys.modules, 'tf2_msgs', ModuleType('tf2_msgs'))
    monkeypatch.setitem(sys.modules, 'tf2_msgs.msg', module)
    monkeypatch.setattr(transforms, 'HAS_TF', True)
    monkeypatch.setattr(transforms.rclpy, 'spin_once', lambda node, timeout_sec: node.spun())


def static(child: str, x: float, quat=(0.0, 0.0, 0.0, 1.0), parent: str = 'base_link'):
    message = conversions.TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.transform.translation.x = x
    q = message.transform.rotation
    q.x, q.y, q.z, q.w = quat
    return message


def estimate() -> Estimate:
    return Estimate(5, np.array([1.0, 2.0, 0.5]), np.eye(3), np.zeros(3), np.eye(3), 1.0, False)


def test_a_mount_on_tf_static_wins_and_the_difference_is_said(tf, caplog):
    turned = tuple(geometry.quat_from_yaw(np.pi / 2))
    node = FakeNode([TFMessage([static('horizontal_laser', 3.0, turned),
                                static('vertical_side_laser', 9.0, parent='roof')])])
    with caplog.at_level(logging.WARNING):
        vehicle, heard = transforms.mounts_from_tf(node, NodeSettings(tf_static_wait=0.05))
    assert heard == {'horizontal_laser'}
    file = NodeSettings().vehicle()
    np.testing.assert_allclose(vehicle.horizontal.planar_mount, [3.0, 0.0, np.pi / 2])
    for got, said in zip(vehicle.verticals, file.verticals):    # a mount on the roof is not ours
        np.testing.assert_array_equal(got.T_base_laser, said.T_base_laser)
    assert 'horizontal_laser' in caplog.text
    assert node.spun is None


def test_no_waiting_means_the_file(tf):
    node = FakeNode([TFMessage([static('horizontal_laser', 3.0)])])
    vehicle, heard = transforms.mounts_from_tf(node, NodeSettings(tf_static_wait=0.0))
    assert not heard
    assert vehicle.horizontal.T_base_laser[0, 3] == 0.0


def test_a_mount_without_direction_is_refused(tf):
    node = FakeNode([TFMessage([static('horizontal_laser', 3.0, (0.0, 0.0, 0.0, 0.0))])])
    with pytest.raises(VehicleError, match='/tf_static to "horizontal_laser"'):
        transforms.mounts_from_tf(node, NodeSettings(tf_static_wait=0.05))


def test_odom_to_base_is_published_on_tf(tf):
    node = FakeNode([])
    transform = conversions.transform_message(estimate(), 'odom', 'base_link')
    transforms.TransformOutput(node).publish(transform)
    assert node.published == [('/tf', TFMessage([transform]))]
    assert (transform.header.frame_id, transform.child_frame_id) == ('odom', 'base_link')


def test_without_tf2_msgs_that_is_said_once_and_nothing_else_happens(monkeypatch):
    monkeypatch.setattr(transforms, 'HAS_TF', False)
    node = FakeNode([])
    output = transforms.TransformOutput(node)
    for _ in range(3):
        output.publish(conversions.transform_message(estimate(), 'odom', 'base_link'))
    assert len(node.said) == 1
    assert node.published == []
    vehicle, _ = transforms.mounts_from_tf(node, NodeSettings())
    assert vehicle.horizontal.name == 'horizontal'


def test_mounts_are_published_as_the_vehicle_file_has_them(tf):
    node, vehicle = FakeNode([]), NodeSettings().vehicle()
    transforms.TransformOutput(node).publish_static(
        conversions.mount_messages(vehicle, 'base_link'))
    (topic, message), = node.published
    assert topic == '/tf_static'
    assert [t.header.frame_id for t in message.transforms] == ['base_link'] * 4
    for stamped, scanner in zip(message.transforms, vehicle.scanners):
        assert stamped.child_frame_id == scanner.frame
        np.testing.assert_allclose(transforms.matrix(stamped), scanner.T_base_laser, atol=1e-12)
