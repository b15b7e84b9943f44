# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What all nodes say on /diagnostics, gathered for the supervisor's screen."""

from __future__ import annotations

import threading
import time
from types import TracebackType

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from stri_mapping.status import NodeStatus


class GraphMonitor:
    """
    Listens to /diagnostics in a thread; a context manager.

    Attributes
    ----------
    statuses
        The newest by the node's full name without its first slash.

    """

    def __init__(self) -> None:
        """Connect; nothing is heard before the context is entered."""
        self.statuses: dict[str, NodeStatus] = {}
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('stri_mapping_monitor', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._take, 100)
        self._thread = threading.Thread(target=self._spin, daemon=True)

    def __enter__(self) -> GraphMonitor:
        """Begin to listen."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop listening."""
        self._context.try_shutdown()
        self._thread.join(5.0)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass

    def _take(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.partition(':')[0]
            values = {pair.key: pair.value for pair in status.values}
            self.statuses[name] = NodeStatus(
                int.from_bytes(status.level, 'little'), status.message, values, time.monotonic())

    def ready(self, name: str) -> bool:
        """Return whether a node has been heard of."""
        return name in self.statuses
