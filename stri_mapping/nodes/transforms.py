# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The tf tree, where tf2_msgs is installed: odom to base_link out, mounts in."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
import time
from typing import Any

from geometry_msgs.msg import TransformStamped
import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from stri_mapping import geometry
from stri_mapping.errors import VehicleError
from stri_mapping.nodes.parameters import NodeSettings
from stri_mapping.vehicle import remounted, Vehicle

# The pip wheels have no tf2_msgs: everything but /tf works without it.
HAS_TF = find_spec('tf2_msgs') is not None
STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class TransformOutput:
    """Publishes transforms; does nothing but say so once where tf2_msgs is missing."""

    def __init__(self, node: Node) -> None:
        """Get ready; a publisher is made with the first transform."""
        self._node = node
        self._publishers: dict[str, Any] = {}
        if not HAS_TF:
            node.get_logger().info('tf2_msgs is not installed: /tf is not published')

    def publish(self, transform: TransformStamped) -> None:
        """Publish one transform on /tf."""
        self._publish('/tf', 100, [transform])

    def publish_static(self, transforms: Sequence[TransformStamped]) -> None:
        """Publish transforms that stay as they are on /tf_static."""
        self._publish('/tf_static', STATIC, transforms)

    def _publish(self, topic: str, qos: QoSProfile | int,
                 transforms: Sequence[TransformStamped]) -> None:
        if not HAS_TF or not transforms:
            return
        from tf2_msgs.msg import TFMessage
        if topic not in self._publishers:
            self._publishers[topic] = self._node.create_publisher(TFMessage, topic, qos)
        self._publishers[topic].publish(TFMessage(transforms=list(transforms)))


def mounts_from_tf(node: Node, settings: NodeSettings) -> tuple[Vehicle, set[str]]:
    """
    Return the vehicle of the settings, with those mounts that /tf_static has, and their frames.

    The node is spun while waiting for them, so nothing else may be subscribed yet.
    """
    vehicle, patience = settings.vehicle(), settings.tf_static_wait
    if not HAS_TF or patience <= 0.0:
        return vehicle, set()
    from tf2_msgs.msg import TFMessage
    heard: dict[str, NDArray[np.float64]] = {}

    def take(message: Any) -> None:
        for stamped in message.transforms:
            if stamped.header.frame_id.lstrip('/') == settings.base_frame:
                heard[stamped.child_frame_id.lstrip('/')] = matrix(stamped)

    subscription = node.create_subscription(TFMessage, '/tf_static', take, STATIC)
    end = time.monotonic() + patience
    while time.monotonic() < end and any(s.frame not in heard for s in vehicle.scanners):
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_subscription(subscription)
    return Vehicle(tuple(remounted(s, s.frame, heard[s.frame]) if s.frame in heard else s
                         for s in vehicle.scanners)), set(heard)


def matrix(stamped: TransformStamped) -> NDArray[np.float64]:
    """Return the 4x4 transform of a message."""
    t, q = stamped.transform.translation, stamped.transform.rotation
    T = np.eye(4)
    try:
        T[:3, :3] = geometry.rotation_from_quat((q.x, q.y, q.z, q.w))
    except ValueError as error:
        raise VehicleError(f'/tf_static to "{stamped.child_frame_id}": {error}') from None
    T[:3, 3] = (t.x, t.y, t.z)
    return T
