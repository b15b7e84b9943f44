# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""All topics there are on the way in: serialised messages, gathered and taken now and then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
import yaml

from stri_mapping.nodes.polling import Polled, take_all
from stri_mapping.nodes.raw_output import message_class
from stri_mapping.recording.definitions import Definitions
from stri_mapping.recording.mcap_file import Topic

# Seconds between two looks for new topics.
LOOK_PERIOD = 0.5
# Messages that a reader holds while they are not taken: 13 s of a scanner's.
DEPTH = 1000


class RawMessage(NamedTuple):
    """One serialised message and when it came."""

    topic: Topic
    received_ns: int
    sent_ns: int
    data: bytes


class RawInput:
    """
    Subscribes to whatever is published.

    Parameters
    ----------
    node
        Owner of the subscriptions.
    wanted, unwanted
        Topics, separated by spaces; none wanted means all.  An unwanted one that ends in / means
        all below it.

    """

    def __init__(self, node: Node, wanted: str, unwanted: str) -> None:
        """Look for topics, now and from time to time."""
        self._node = node
        self._wanted, self._unwanted = self._resolved(wanted), self._resolved(unwanted)
        self._definitions = Definitions()
        self._group = Polled()
        self._inputs: dict[str, tuple[Subscription, Topic]] = {}
        self._passed_over: set[str] = set()
        node.create_timer(LOOK_PERIOD, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._look()

    def __len__(self) -> int:
        """Return the number of topics."""
        return len(self._inputs)

    def take(self) -> Iterator[RawMessage]:
        """Iterate over what has gathered, topic by topic."""
        for subscription, topic in self._inputs.values():
            for data, info in take_all(subscription):
                yield RawMessage(topic, info['received_timestamp'], info['source_timestamp'],
                                 bytes(data))

    def latched(self, name: str) -> bool:
        """Return whether a topic's last message stays of interest."""
        durability = self._inputs[name][0].qos_profile.durability
        return bool(durability is DurabilityPolicy.TRANSIENT_LOCAL)

    def _resolved(self, names: str) -> list[str]:
        """Return topics with their namespace; a slash at the end stays."""
        return [self._node.resolve_topic_name(name.rstrip('/')) + '/' * name.endswith('/')
                for name in names.split()]

    def _look(self) -> None:
        """Subscribe to topics that have come up, and anew where publishers offer less now."""
        for name, kinds in self._node.get_topic_names_and_types():
            if not self._wants(name) or name in self._passed_over:
                continue
            publishers = self._node.get_publishers_info_by_topic(name)
            if publishers:
                qos = reader_qos(publishers)
                have = self._inputs.get(name)
                if have is None or have[0].qos_profile.reliability != qos.reliability:
                    self._subscribe(name, kinds[0], publishers, qos)

    def _wants(self, name: str) -> bool:
        if any(name == each or each.endswith('/') and name.startswith(each)
               for each in self._unwanted):
            return False
        return not self._wanted or name in self._wanted

    def _subscribe(self, name: str, kind: str, publishers: Sequence[TopicEndpointInfo],
                   qos: QoSProfile) -> None:
        topic = self._definitions.topic(name, kind, offered_qos(publishers))
        message = message_class(kind)
        if topic is None or message is None:
            self._passed_over.add(name)
            self._node.get_logger().warning(f'{name} is left out: {kind} is not installed')
            return
        if name in self._inputs:
            self._node.destroy_subscription(self._inputs[name][0])
        self._inputs[name] = self._node.create_subscription(
            message, name, lambda _: None, qos, raw=True, callback_group=self._group), topic


def reader_qos(publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Return the most that all publishers of a topic offer."""
    profiles = [each.qos_profile for each in publishers]
    reliable = all(p.reliability is ReliabilityPolicy.RELIABLE for p in profiles)
    latched = all(p.durability is DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def offered_qos(publishers: Sequence[TopicEndpointInfo]) -> str:
    """Return the publishers' quality of service as rosbag2 notes it in version 9."""
    def seconds(duration: Duration) -> dict[str, int]:
        return {'sec': duration.nanoseconds // 10**9, 'nsec': duration.nanoseconds % 10**9}

    return str(yaml.safe_dump([{
        'history': p.history.name.lower(), 'depth': p.depth,
        'reliability': p.reliability.name.lower(), 'durability': p.durability.name.lower(),
        'deadline': seconds(p.deadline), 'lifespan': seconds(p.lifespan),
        'liveliness': p.liveliness.name.lower(),
        'liveliness_lease_duration': seconds(p.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': p.avoid_ros_namespace_conventions,
    } for p in (each.qos_profile for each in publishers)], sort_keys=False))
