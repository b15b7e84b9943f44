# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A bag's topics on the way out: serialised messages that do not get lost, and /clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from importlib import import_module
import math
import struct
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from stri_mapping.errors import StriMappingError, UsageError
from stri_mapping.nodes.conversions import time_message
from stri_mapping.nodes.process import StopRequest

# Keeping all, a publisher waits for readers that fall behind instead of dropping messages.
LOSSLESS = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_ALL)
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CLOCK = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
# Seconds that a subscriber may block before it is taken for dead.
BLOCKED = 60.0
# Seconds by which a subscriber may learn of a publisher later than that of it: DDS has no
# handshake for it, and what is sent in between is lost on readers of other makes.
SETTLED = 0.5
# Between two looks at whether the process is to stop.
MOMENT = Duration(seconds=0.5)


class RawOutput:
    """
    One publisher a topic, fed with bytes, and the clock that goes with them.

    Parameters
    ----------
    node
        Owner of the publishers.
    types
        Message type, such as sensor_msgs/msg/LaserScan, by topic.  Topics of types that are not
        installed are left out, which is said.
    stop
        Ends all waiting when requested.

    Raises
    ------
    StriMappingError
        If no topic is left.

    """

    def __init__(self, node: Node, types: Mapping[str, str], stop: StopRequest) -> None:
        """Create the publishers."""
        self.sent: Counter[str] = Counter()
        self._stop = stop
        self._clock = node.create_publisher(Clock, '/clock', CLOCK)
        self._publishers: dict[str, Publisher] = {}
        for topic, kind in sorted(types.items()):
            message = message_class(kind)
            if message is None:
                node.get_logger().info(f'{topic} is left out: {kind} is not installed')
            else:
                qos = LATCHED if topic == '/tf_static' else LOSSLESS
                self._publishers[topic] = node.create_publisher(message, topic, qos)
        if not self._publishers:
            raise StriMappingError('nothing to play: no topic of a type that is installed')

    @property
    def topics(self) -> list[str]:
        """Topics that have a publisher."""
        return list(self._publishers)

    def await_subscribers(self, wanted: Mapping[str, int], patience: float,
                          meanwhile: Callable[[], None]) -> None:
        """
        Wait until each topic has so many matched subscribers, and for `SETTLED` seconds more.

        Raises
        ------
        StriMappingError
            If they do not come.

        """
        for topic in wanted:
            if topic not in self._publishers:
                raise UsageError(f'parameter subscribers: {topic} is not played')
        end, since = time.monotonic() + patience, math.inf
        while wanted and not self._stop.requested:
            missing = [topic for topic, count in wanted.items()
                       if self._publishers[topic].get_subscription_count() < count]
            since = math.inf if missing else min(since, time.monotonic())
            if time.monotonic() > since + SETTLED:
                return
            if missing and time.monotonic() > end:
                raise StriMappingError(f'{missing[0]}: nobody subscribed within {patience:.0f} s')
            meanwhile()
            time.sleep(0.02)

    def tick(self, stamp: int) -> None:
        """Publish the time, nanoseconds, on /clock."""
        self._clock.publish(Clock(clock=time_message(stamp)))

    def publish(self, topic: str, data: bytes) -> None:
        """Publish; a full history means that a subscriber is behind, and it is waited for."""
        end = time.monotonic() + BLOCKED
        while not self._stop.requested:
            try:
                self._publishers[topic].publish(data)
            except rclpy_implementation.RCLError:
                if time.monotonic() > end:
                    raise StriMappingError(f'{topic}: a subscriber took nothing for '
                                           f'{BLOCKED:.0f} s') from None
            else:
                self.sent[topic] += 1
                return

    def await_acknowledgements(self) -> None:
        """Wait until every subscriber has everything, or raise StriMappingError."""
        end = time.monotonic() + BLOCKED
        for topic, publisher in self._publishers.items():
            while not publisher.wait_for_all_acked(MOMENT) and not self._stop.requested:
                if time.monotonic() > end:
                    raise StriMappingError(f'{topic}: a subscriber did not acknowledge '
                                           'everything')


def message_class(kind: str) -> Any:
    """Return the class of a type such as sensor_msgs/msg/LaserScan; None if not installed."""
    package, _, name = kind.partition('/msg/')
    try:
        return getattr(import_module(f'{package}.msg'), name, None)
    except ImportError:
        return None


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp of a serialised message that begins with a std_msgs/Header."""
    order = '<' if data[1] & 1 else '>'
    sec, nanosec = struct.unpack_from(f'{order}iI', data, 4)
    return int(sec) * 10**9 + int(nanosec)
