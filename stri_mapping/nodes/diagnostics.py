# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What a node says of itself on /diagnostics, once a second (REP-107)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from stri_mapping.nodes.conversions import status_message

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Report(NamedTuple):
    """State of one part: level, one line, and figures."""

    level: bytes
    message: str
    values: Mapping[str, object]


class Diagnostics:
    """
    Publishes the reports of a node's parts at 1 Hz of real time, also under simulated time.

    Parameters
    ----------
    node
        Owner of publisher and timer.
    parts
        By the part's name: what tells its state.
    hardware
        Identifies the device, where the node has one; may be set when it becomes known.

    """

    def __init__(self, node: Node, parts: Mapping[str, Callable[[], Report]],
                 hardware: str = '') -> None:
        """Start the timer."""
        self._node, self._parts, self.hardware = node, parts, hardware
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        node.create_timer(1.0, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self) -> None:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        name = self._node.get_fully_qualified_name().lstrip('/')
        for part, report in self._parts.items():
            level, text, values = report()
            message.status.append(
                status_message(f'{name}: {part}', level, text, values, self.hardware))
        self._publisher.publish(message)
