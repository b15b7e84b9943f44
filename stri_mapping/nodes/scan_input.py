# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Subscription to one scanner that loses nothing from a reliable publisher, and takes any."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, qos_profile_sensor_data, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import LaserScan

from stri_mapping.nodes.polling import Polled, take_all, wait_for
from stri_mapping.nodes.qos import subscribe
from stri_mapping.scan import Scan, ScanCounts, ScanIntake, stamp_ns
from stri_mapping.scan_log import ScanLog
from stri_mapping.vehicle import Scanner

# Keeping all, a reader that falls behind holds its publisher back instead of losing scans.
LOSSLESS = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_ALL)
# Stamps that go back so far are not out of order: time itself was set back, as by a bag's loop.
JUMP_NS = 1_000_000_000
# Scans taken before anything else has its turn.
AT_ONCE = 50
# Seconds between two looks at what the publishers offer.
LOOK_PERIOD = 0.5


class ScanInput:
    """
    Scans of one scanner, checked and in order, handed to a callback.

    Messages gather in the reader until `take` is called.  The subscription is reliable.  When a
    publisher turns up that offers best effort only, which a reliable subscription would never
    hear, it is replaced by a best-effort one.

    Parameters
    ----------
    node
        Owner of the subscription.
    scanner
        Whose topic is subscribed.
    callback
        Takes each good scan, and the serialised message that it came in.
    on_jump
        Called when the stamps have gone back by more than a second, before the first scan of
        the new time is handed on.
    log
        Keeps what came; by default in memory alone.

    Attributes
    ----------
    scanner
        As given.

    """

    def __init__(self, node: Node, scanner: Scanner, callback: Callable[[Scan, bytes], None],
                 on_jump: Callable[[], object] = lambda: None, log: ScanLog | None = None,
                 ) -> None:
        """Subscribe."""
        self._node, self._topic, self._callback = node, scanner.topic, callback
        self.scanner = scanner
        self._on_jump = on_jump
        self._awaits_jump = False
        self._begin(log or ScanLog())
        self._newest = self._log.stamps[-1] if self._log.stamps else 0
        self._group = Polled()
        self._subscription = subscribe(node, LaserScan, scanner.topic, _taken, LOSSLESS,
                                       callback_group=self._group, raw=True)
        node.create_timer(LOOK_PERIOD, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def counts(self) -> ScanCounts:
        """Scans taken and left out since the last such jump."""
        return self._log.counts

    @property
    def stamps(self) -> Sequence[int]:
        """Stamps of the scans handed on since then, nanoseconds."""
        return self._log.stamps

    def _begin(self, log: ScanLog) -> None:
        self._log, self._intake = log, ScanIntake(self._topic, log.counts)

    def close(self) -> None:
        """Keep nothing on disk any more."""
        self._log.close()

    def forget(self) -> None:
        """Hand on nothing more of the time before a jump that others have seen already."""
        self._awaits_jump = self._newest > 0

    def wait(self, timeout: float) -> None:
        """Wait until there is something to take, for some seconds at most."""
        wait_for(self._node, self._subscription, timeout)

    def take(self) -> int:
        """Hand on what has gathered, up to `AT_ONCE` scans; return how many."""
        count = 0
        for data, _ in islice(take_all(self._subscription), AT_ONCE):
            self._take(data)
            count += 1
        return count

    def _take(self, data: bytes) -> None:
        message = deserialize_message(data, LaserScan)
        stamp = stamp_ns(message.header.stamp)
        if stamp < self._newest - JUMP_NS:
            if not self._awaits_jump:
                self._on_jump()
            self._awaits_jump = False
            self._begin(ScanLog())
        elif self._awaits_jump:
            return
        self._newest = stamp
        scan = self._intake.take(message)
        self._log.note(None if scan is None else scan.stamp_ns)
        if scan is not None:
            self._callback(scan, data)

    def _look(self) -> None:
        """Accept best effort once a publisher offers no more."""
        if (self._subscription.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT
                or all(each.qos_profile.reliability is ReliabilityPolicy.RELIABLE for each
                       in self._node.get_publishers_info_by_topic(self._subscription.topic))):
            return
        self._node.get_logger().info(
            f'{self._topic}: a publisher offers best effort only; some scans may get lost')
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._node.create_subscription(
            LaserScan, self._topic, _taken, qos_profile_sensor_data, callback_group=self._group,
            raw=True)


def _taken(data: bytes) -> None:
    """Do nothing: `ScanInput.take` has every message."""
