# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node: a bag's messages onto their topics, byte for byte, at the pace of recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
import os
from pathlib import Path
import struct
import sys
import time

from nav_msgs.msg import Odometry
from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import SetBool, Trigger

from stri_mapping.bag_io import Bag, LASER_SCAN
from stri_mapping.errors import BagError, UsageError
from stri_mapping.nodes.diagnostics import Diagnostics, OK, Report
from stri_mapping.nodes.parameters import declare, setting
from stri_mapping.nodes.process import guarded, StopRequest, warn_of_unknown_parameters
from stri_mapping.nodes.raw_output import header_stamp_ns, RawOutput
from stri_mapping.pacing import Pacer
from stri_mapping.scan import stamp_ns

# How far the player may be ahead of the odometry that it follows, and for how long that may stand
# still: time enough for an estimator to start, little enough that nothing piles up.
LEAD_NS, SILENT = 2_000_000_000, 10.0
PROGRESS_PERIOD = 5.0
# Seconds between two looks at services and parameters, and the longest sleep.
LOOK_PERIOD = 0.05
POSITION = struct.Struct('<Q')


@dataclass(frozen=True)
class PlayerSettings:
    """
    What the player can be told.

    Attributes
    ----------
    bag
        Path of the bag.
    rate
        Speed over that of recording; 0 for as fast as the subscribers take it. May be changed
        while playing.
    start
        Seconds of the bag to leave out at its beginning; /tf_static is played all the same.
    duration
        Seconds of the bag to play; 0 for all.
    loop
        Whether to begin again at the end, until stopped; stamps and /clock then go back.
    topics
        Topics to play, separated by spaces; empty for all.
    subscribers
        Topics, each as often as subscribers are to be connected before the first message.
    patience
        Seconds to wait for them.
    follow
        Topic of the odometry made from the scans, not to run far ahead of; empty for none.
    position
        File that keeps how many messages were played; empty for none.
    resume
        Go on after the message that the file says, as after a crash.

    """

    bag: str = ''
    rate: float = setting(1.0, 0.0, 1000.0, live=True)
    start: float = setting(0.0, 0.0, 1e9)
    duration: float = setting(0.0, 0.0, 1e9)
    loop: bool = False
    topics: str = ''
    subscribers: str = ''
    patience: float = setting(120.0, 0.0, 1e6)
    follow: str = ''
    position: str = ''
    resume: bool = False


class BagPlayer:
    """Plays one bag through DDS with /clock, and loses nothing on the way."""

    def __init__(self, stop: StopRequest) -> None:
        """Declare parameters and services; the bag is opened in `run`."""
        self.node = Node('bag_player')
        self.settings = settings = declare(self.node, PlayerSettings)
        warn_of_unknown_parameters(self.node)
        if not settings.bag:
            raise UsageError('parameter bag: want the path of a bag')
        self._stop = stop
        self._pacer = Pacer(settings.rate)
        self._played = 0                         # messages of the bag that are done with
        self._looked = self._spoken = 0.0
        self._followed_ns: int | None = None     # stamp that the followed odometry has reached
        self._newest_ns = 0                      # stamp of the newest scan played in this pass
        self._following = bool(settings.follow)
        if self._following:
            self.node.create_subscription(Odometry, settings.follow, self._follow,
                                          qos_profile_sensor_data,
                                          event_callbacks=SubscriptionEventCallbacks(
                                              matched=self._match))
        self.node.add_post_set_parameters_callback(self._set)
        self.node.create_service(SetBool, '~/pause', self._pause)
        self.node.create_service(Trigger, '~/step', self._step)
        self._diagnostics = Diagnostics(self.node, {'playing': self._report})
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def run(self) -> None:
        """Play the bag, then wait until every subscriber has all of it."""
        log, settings = self.node.get_logger(), self.settings
        position = self._open_position()
        with Bag(Path(settings.bag)) as bag:
            output = RawOutput(self.node, self._chosen(bag), self._stop)
            output.await_subscribers(Counter(settings.subscribers.split()), settings.patience,
                                     self._look)
            log.info(f'playing {bag.path}: {bag.duration_ns * 1e-9:.1f} s')
            self._play(bag, output, position)
            while settings.loop and not self._stop.requested:
                self._played, self._followed_ns, self._newest_ns = 0, None, 0
                self._play(bag, output, position)
        output.await_acknowledgements()
        log.info('played ' + ', '.join(f'{n} {topic}' for topic, n in sorted(output.sent.items())))

    def _chosen(self, bag: Bag) -> dict[str, str]:
        """Return the types of the topics to play; /clock is the player's own."""
        wanted = self.settings.topics.split() or list(bag.topics)
        for topic in wanted:
            if topic not in bag.topics:
                raise BagError(f'{bag.path}: no topic {topic}; topics there: {bag.listing}')
        return {topic: bag.topics[topic] for topic in wanted if topic != '/clock'}

    def _open_position(self) -> int | None:
        """Open the file that keeps the position, and take it up where that is asked for."""
        if not self.settings.position:
            return None
        file = os.open(self.settings.position, os.O_RDWR | os.O_CREAT, 0o644)
        kept = os.pread(file, POSITION.size, 0)
        if self.settings.resume and len(kept) == POSITION.size:
            self._played, = POSITION.unpack(kept)
        return file

    def _play(self, bag: Bag, output: RawOutput, position: int | None) -> None:
        """Play the bag once, from the message that is next."""
        settings, messages = self.settings, enumerate(bag.cdr_messages(output.topics), start=1)
        end = settings.start + (settings.duration or float('inf'))
        begun = False
        for number, (connection, log_ns, data) in islice(messages, self._played, None):
            moment = (log_ns - bag.start_ns) * 1e-9
            if moment > end or self._stop.requested:
                return
            if moment >= settings.start:
                if not begun:
                    self._pacer.begin(moment)
                    begun = True
                self._await(moment)
                if self._following and connection.msgtype == LASER_SCAN:
                    self._stay_close(header_stamp_ns(data))
                if self._stop.requested:
                    return
                self._pacer.passed(moment)
                output.tick(log_ns)
            elif connection.topic != '/tf_static':
                continue
            output.publish(connection.topic, bytes(data))
            self._played = number
            if position is not None:
                os.pwrite(position, POSITION.pack(self._played), 0)
            self._tell(moment, bag.duration_ns * 1e-9)

    def _await(self, moment: float) -> None:
        """Wait until a message's moment has come, seeing to services meanwhile."""
        while not self._stop.requested:
            left = self._pacer.wait(moment)
            if time.monotonic() > self._looked + LOOK_PERIOD:
                self._look()
            elif left > 0.0:
                time.sleep(min(left, LOOK_PERIOD))
            else:
                return

    def _look(self) -> None:
        """See to services, parameters and the odometry that is followed."""
        self._looked = time.monotonic()
        self._executor.spin_once(timeout_sec=0.0)

    def _tell(self, moment: float, duration: float) -> None:
        if time.monotonic() > self._spoken + PROGRESS_PERIOD:
            if self._spoken:
                self.node.get_logger().info(f'{moment:.0f} of {duration:.0f} s played')
            self._spoken = time.monotonic()

    def _match(self, info: QoSSubscriptionMatchedInfo) -> None:
        """Follow an odometry that comes up, as of a restarted estimator, from here on."""
        if info.current_count_change > 0:
            self._followed_ns = None

    def _follow(self, message: Odometry) -> None:
        """Note how far the odometry is; what is ahead of the scans is of the pass before."""
        stamp = stamp_ns(message.header.stamp)
        if stamp <= self._newest_ns:
            self._followed_ns = stamp

    def _stay_close(self, scan_ns: int) -> None:
        """Wait until the followed odometry is near a scan about to be played, not for ever."""
        end = time.monotonic() + SILENT
        while not self._stop.requested:
            if self._followed_ns is None:
                self._followed_ns = scan_ns
            if scan_ns - self._followed_ns <= LEAD_NS:
                self._newest_ns = scan_ns
                return
            if time.monotonic() > end:
                self.node.get_logger().warning(
                    f'{self.settings.follow}: silent for {SILENT:.0f} s; playing on without it')
                self._following = False
                return
            self._executor.spin_once(timeout_sec=LOOK_PERIOD)

    def _set(self, parameters: Sequence[Parameter]) -> None:
        for each in parameters:
            if each.name == 'rate':
                self._pacer.rate = float(each.value)

    def _pause(self, request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
        self._pacer.pause(request.data)
        answer.success, answer.message = True, 'paused' if request.data else 'playing'
        return answer

    def _step(self, request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.success = self._pacer.paused
        answer.message = 'one message' if answer.success else 'not paused'
        if answer.success:
            self._pacer.step()
        return answer

    def _report(self) -> Report:
        values = {'Messages': self._played, 'Rate': f'{self._pacer.rate:g}',
                  'Seconds of the bag': f'{self._pacer.moment:.1f}'}
        return Report(OK, 'paused' if self._pacer.paused else 'playing', values)


def main(args: list[str] | None = None) -> int:
    """Run the node until the bag has been played."""
    return guarded(lambda stop: BagPlayer(stop).run(), args)


if __name__ == '__main__':
    sys.exit(main())
