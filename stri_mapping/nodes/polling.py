# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Subscriptions whose messages are taken without the executor.

rclpy builds a wait set of all that a node has anew for every message, which at some hundreds a
second takes more of a processor than their content.  Who is in no hurry lets messages gather in
the reader; who is waits for these subscriptions alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription


class Polled(CallbackGroup):
    """
    Keeps the executor's hands off the subscriptions in it, and off their events.

    An executor that waits for a subscription's events wakes up at its messages too.
    """

    def can_execute(self, entity: Any) -> bool:
        """Return False: the owner takes the messages himself."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return False, see `can_execute`."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: no execution begins."""


def take_all(subscription: Subscription) -> Iterator[tuple[Any, dict[str, int]]]:
    """
    Take what has gathered in a subscription's reader.

    Yields
    ------
    tuple
        The message (bytes for a raw subscription), and `received_timestamp` and
        `source_timestamp` in nanoseconds since 1970.

    """
    with subscription.handle:
        while True:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                return
            yield taken


def wait_for(node: Node, subscription: Subscription, timeout: float) -> None:
    """Wait until a subscription has a message, for some seconds at most."""
    handle, context = subscription.handle, node.context.handle
    assert context is not None
    with context, handle:
        wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, context)
        wait_set.clear_entities()
        wait_set.add_subscription(handle)
        wait_set.wait(round(1e9 * timeout))
