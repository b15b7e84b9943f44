# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Subscriptions that are emptied now and then instead of waking the process at every message.

rclpy builds a wait set anew for every message, which at some hundreds a second takes more of a
processor than their content.  Who is in no hurry lets them gather in the reader.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.subscription import Subscription


class Polled(CallbackGroup):
    """Keeps the executor's hands off the subscriptions in it."""

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
