# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node: a bag's messages onto their topics, byte for byte, at the pace of recording."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
import sys
import time

from nav_msgs.msg import Odometry
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from stri_mapping.bag_io import Bag, LASER_SCAN
from stri_mapping.errors import BagError, UsageError
from stri_mapping.nodes.parameters import declare
from stri_mapping.nodes.process import guarded, StopRequest, warn_of_unknown_parameters
from stri_mapping.nodes.raw_output import header_stamp_ns, RawOutput
from stri_mapping.scan import stamp_ns

# How far the player may be ahead of the odometry that it follows, and for how long that may stand
# still: time enough for an estimator to start, little enough that nothing piles up.
LEAD_NS, SILENT = 2_000_000_000, 10.0
PROGRESS_PERIOD = 5.0


@dataclass(frozen=True)
class PlayerSettings:
    """
    What the player can be told.

    Attributes
    ----------
    bag
        Path of the bag.
    rate
        Speed over that of recording; 0 for as fast as the subscribers take it.
    topics
        Topics to play, separated by spaces; empty for all.
    subscribers
        Topics, each as often as subscribers are to be connected before the first message.
    patience
        Seconds to wait for them.
    follow
        Topic of the odometry made from the scans, not to run far ahead of; empty for none.

    """

    bag: str = ''
    rate: float = 1.0
    topics: str = ''
    subscribers: str = ''
    patience: float = 120.0
    follow: str = ''


class BagPlayer:
    """Plays one bag through DDS with /clock, and loses nothing on the way."""

    def __init__(self, stop: StopRequest) -> None:
        """Declare the parameters; the bag is opened in `run`."""
        self.node = Node('bag_player')
        self.settings = declare(self.node, PlayerSettings)
        warn_of_unknown_parameters(self.node)
        if not self.settings.bag:
            raise UsageError('parameter bag: want the path of a bag')
        if not 0.0 <= self.settings.rate < float('inf'):
            raise UsageError(f'parameter rate is {self.settings.rate}: want 0 or more')
        self._stop = stop
        self._following = bool(self.settings.follow)
        self._followed_ns: int | None = None     # stamp that the followed odometry has reached
        if self._following:
            self.node.create_subscription(Odometry, self.settings.follow, self._follow,
                                          qos_profile_sensor_data)

    def run(self) -> None:
        """Play the whole bag, then wait until every subscriber has all of it."""
        log, settings = self.node.get_logger(), self.settings
        with Bag(Path(settings.bag)) as bag:
            output = RawOutput(self.node, self._chosen(bag), self._stop)
            output.await_subscribers(Counter(settings.subscribers.split()), settings.patience)
            log.info(f'playing {bag.path}: {bag.duration_ns * 1e-9:.1f} s')
            self._play(bag, output)
        output.await_acknowledgements()
        log.info('played ' + ', '.join(f'{n} {topic}' for topic, n in sorted(output.sent.items())))

    def _chosen(self, bag: Bag) -> dict[str, str]:
        """Return the types of the topics to play; /clock is the player's own."""
        wanted = self.settings.topics.split() or list(bag.topics)
        for topic in wanted:
            if topic not in bag.topics:
                raise BagError(f'{bag.path}: no topic {topic}; topics there: {bag.listing}')
        return {topic: bag.topics[topic] for topic in wanted if topic != '/clock'}

    def _play(self, bag: Bag, output: RawOutput) -> None:
        start_ns, start = None, time.monotonic()
        spoken = start
        for connection, log_ns, data in bag.cdr_messages(output.topics):
            start_ns = log_ns if start_ns is None else start_ns
            elapsed = (log_ns - start_ns) * 1e-9
            self._pace(start, elapsed)
            if self._following and connection.msgtype == LASER_SCAN:
                self._stay_close(header_stamp_ns(data))
            if self._stop.requested:
                return
            if time.monotonic() > spoken + PROGRESS_PERIOD:
                spoken = time.monotonic()
                self.node.get_logger().info(
                    f'{elapsed:.0f} of {bag.duration_ns * 1e-9:.0f} s played')
            output.tick(log_ns)
            output.publish(connection.topic, bytes(data))

    def _pace(self, start: float, elapsed: float) -> None:
        """Sleep until a message's moment has come."""
        if self.settings.rate == 0.0:
            return
        due = start + elapsed / self.settings.rate
        while not self._stop.requested and (left := due - time.monotonic()) > 0.0:
            time.sleep(min(left, 0.1))

    def _follow(self, message: Odometry) -> None:
        self._followed_ns = stamp_ns(message.header.stamp)

    def _stay_close(self, scan_ns: int) -> None:
        """Wait until the followed odometry is near a scan about to be played, not for ever."""
        if self._followed_ns is None:
            self._followed_ns = scan_ns
        end = time.monotonic() + SILENT
        rclpy.spin_once(self.node, timeout_sec=0.0)
        while scan_ns - self._followed_ns > LEAD_NS and not self._stop.requested:
            if time.monotonic() > end:
                self.node.get_logger().warning(
                    f'{self.settings.follow}: silent for {SILENT:.0f} s; playing on without it')
                self._following = False
                return
            rclpy.spin_once(self.node, timeout_sec=0.05)


def main(args: list[str] | None = None) -> int:
    """Run the node until the bag has been played."""
    return guarded(lambda stop: BagPlayer(stop).run(), args)


if __name__ == '__main__':
    sys.exit(main())
