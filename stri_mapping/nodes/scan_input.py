# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Subscription to one scanner that loses nothing from a reliable publisher, and takes any."""

from __future__ import annotations

from array import array
from collections.abc import Callable

from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, qos_profile_sensor_data, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan

from stri_mapping.scan import Scan, ScanCounts, ScanIntake, stamp_ns
from stri_mapping.vehicle import Scanner

# Keeping all, a reader that falls behind holds its publisher back instead of losing scans.
LOSSLESS = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_ALL)
# Stamps that go back so far are not out of order: time itself was set back, as by a bag's loop.
JUMP_NS = 1_000_000_000


class ScanInput:
    """
    Scans of one scanner, checked and in order, handed to a callback.

    The subscription is reliable.  When a publisher turns up that offers best effort only, which
    a reliable subscription would never hear, it is replaced by a best-effort one.

    Parameters
    ----------
    node
        Owner of the subscription.
    scanner
        Whose topic is subscribed.
    callback
        Takes each good scan.
    on_jump
        Called when the stamps have gone back by more than a second, before the first scan of
        the new time is handed on.

    Attributes
    ----------
    scanner
        As given.
    stamps
        Of the scans handed on since the last such jump, nanoseconds.

    """

    def __init__(self, node: Node, scanner: Scanner, callback: Callable[[Scan], None],
                 on_jump: Callable[[], object] = lambda: None) -> None:
        """Subscribe."""
        self._node, self._topic, self._callback = node, scanner.topic, callback
        self.scanner = scanner
        self._on_jump = on_jump
        self._awaits_jump = False
        self._newest = 0
        self._begin()
        self._subscription = node.create_subscription(
            LaserScan, scanner.topic, self._take, LOSSLESS,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._accept_best_effort))

    @property
    def counts(self) -> ScanCounts:
        """Scans taken and left out so far."""
        return self._intake.counts

    def _begin(self) -> None:
        self._intake = ScanIntake(self._topic)
        self.stamps = array('q')

    def forget(self) -> None:
        """Hand on nothing more of the time before a jump that others have seen already."""
        self._awaits_jump = self._newest > 0

    def _take(self, message: LaserScan) -> None:
        stamp = stamp_ns(message.header.stamp)
        if stamp < self._newest - JUMP_NS:
            if not self._awaits_jump:
                self._on_jump()
            self._awaits_jump = False
            self._begin()
        elif self._awaits_jump:
            return
        self._newest = stamp
        scan = self._intake.take(message)
        if scan is not None:
            self.stamps.append(scan.stamp_ns)
            self._callback(scan)

    def _accept_best_effort(self, event: QoSRequestedIncompatibleQoSInfo) -> None:
        if self._subscription.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT:
            return
        self._node.get_logger().info(
            f'{self._topic}: a publisher offers best effort only; some scans may get lost')
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._node.create_subscription(
            LaserScan, self._topic, self._take, qos_profile_sensor_data)
