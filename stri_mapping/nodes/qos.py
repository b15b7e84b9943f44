# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Endpoints whose quality of service the user may override, as ROS 2 has it.

Parameters named ``qos_overrides./topic.publisher.depth`` (or ``.subscription.``, and
``.history``, ``.reliability``) take the place of what the node would choose.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Any, TypeVar

from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from stri_mapping.errors import UsageError

Endpoint = TypeVar('Endpoint')


def advertise(node: Node, kind: type[Any], topic: str, qos: QoSProfile | int,
              create: Callable[..., Publisher] | None = None) -> Publisher:
    """
    Return a publisher.

    Parameters
    ----------
    node
        Its owner.
    kind, topic
        Message class and name.
    qos
        Unless overridden.
    create
        What makes it, where that is not ``node.create_publisher``.

    Raises
    ------
    UsageError
        If an override is no such policy.

    """
    make = create or node.create_publisher
    made: Publisher = _made(topic, lambda options: make(
        kind, topic, _own(qos), qos_overriding_options=options))
    return made


def subscribe(node: Node, kind: type[Any], topic: str, callback: Callable[[Any], None],
              qos: QoSProfile, **more: Any) -> Subscription:
    """Return a subscription; `more` goes to rclpy, everything else is as with `advertise`."""
    made: Subscription = _made(topic, lambda options: node.create_subscription(
        kind, topic, callback, _own(qos), qos_overriding_options=options, **more))
    return made


def _own(qos: QoSProfile | int) -> QoSProfile:
    """Return a profile of its own for each endpoint: rclpy writes overrides into it."""
    return QoSProfile(depth=qos) if isinstance(qos, int) else copy(qos)


def _made(topic: str, make: Callable[[QoSOverridingOptions], Endpoint]) -> Endpoint:
    try:
        return make(QoSOverridingOptions.with_default_policies())
    except (InvalidParameterTypeException, RuntimeError) as error:
        if 'override' not in str(error):
            raise
        raise UsageError(f'quality of service of {topic}: {" ".join(str(error).split())}; want '
                         'history keep_last or keep_all, a whole number as depth, reliability '
                         'reliable or best_effort') from None
