# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node: all topics, as they are, to Foxglove in a browser or on the desktop, without more ROS."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
import sys

if find_spec('foxglove') is None:
    sys.exit("the package foxglove-sdk is missing: pip install 'stri_mapping[viewer]'")

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from stri_mapping.errors import UsageError
from stri_mapping.nodes.diagnostics import Diagnostics, OK, Report
from stri_mapping.nodes.parameters import declare, setting
from stri_mapping.nodes.process import guarded, StopRequest, warn_of_unknown_parameters
from stri_mapping.nodes.raw_input import RawInput, RawMessage
from stri_mapping.recording.mcap_file import Topic

# Seconds between two takes of what has gathered: smooth enough for eyes.
TAKE_PERIOD = 0.04


@dataclass(frozen=True)
class ViewerSettings:
    """
    What the viewer can be told.

    Attributes
    ----------
    address
        Network address to serve at; 127.0.0.1 for this machine alone, 0.0.0.0 for all.
    port
        Port to serve at; 0 for any that is free.
    topics
        Topics to serve, separated by spaces; empty for all.
    exclude
        Topics to leave out, separated by spaces; a name that ends in / leaves out all below it.

    """

    address: str = '127.0.0.1'
    port: int = setting(8765, 0, 65535)
    topics: str = ''
    exclude: str = ''


class Viewer(ServerListener):  # type: ignore[misc, unused-ignore]
    """Forwards serialised messages with their definitions to a WebSocket."""

    def __init__(self) -> None:
        """Begin to serve."""
        self.node = Node('viewer')
        self.settings = settings = declare(self.node, ViewerSettings)
        warn_of_unknown_parameters(self.node)
        self._channels: dict[str, foxglove.Channel] = {}
        self._last: dict[int, RawMessage] = {}       # of latched topics, by channel
        self._count = 0
        try:
            self._server = foxglove.start_server(
                name='stri_mapping', host=settings.address, port=settings.port,
                server_listener=self, supported_encodings=['cdr'])
        except RuntimeError as error:
            raise UsageError(f'parameters address, port: {settings.address}:{settings.port} '
                             f'cannot be served: {error}') from None
        self._input = RawInput(self.node, settings.topics, settings.exclude)
        self.node.create_timer(TAKE_PERIOD, self._forward,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = Diagnostics(self.node, {'viewing': self._report})
        self.node.get_logger().info(
            f'open ws://{settings.address}:{self._server.port} in Foxglove')

    def run(self, stop: StopRequest) -> None:
        """Serve until asked to stop."""
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        try:
            while not stop.requested:
                executor.spin_once(timeout_sec=0.1)
        finally:
            executor.shutdown()
            self._server.stop()

    def _forward(self) -> None:
        for message in self._input.take():
            channel = self._channels.get(message.topic.name) or self._add(message.topic)
            if self._input.latched(message.topic.name):
                self._last[channel.id()] = message
            channel.log(message.data, log_time=message.received_ns)
            self._count += 1

    def _add(self, topic: Topic) -> foxglove.Channel:
        schema = foxglove.Schema(name=topic.type, encoding=topic.encoding,
                                       data=topic.definition)
        channel = self._channels[topic.name] = foxglove.Channel(
            topic.name, schema=schema, message_encoding='cdr')
        return channel

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Give a viewer that comes late the last message of a latched topic."""
        message = self._last.get(channel.id)
        if message is not None:
            self._channels[message.topic.name].log(message.data, log_time=message.received_ns)

    def _report(self) -> Report:
        return Report(OK, 'serving', {'Address': f'ws://{self.settings.address}:'
                                      f'{self._server.port}', 'Messages': self._count})


def main(args: list[str] | None = None) -> int:
    """Run the node until it is asked to stop."""
    return guarded(lambda stop: Viewer().run(stop), args)


if __name__ == '__main__':
    sys.exit(main())
