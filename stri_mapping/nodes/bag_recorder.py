# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node: topics into a bag, byte for byte, such that neither a crash nor a full disk spoils it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import shutil
import sys
import time

from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from stri_mapping.errors import UsageError
from stri_mapping.nodes.diagnostics import Diagnostics, OK, Report, WARN
from stri_mapping.nodes.parameters import declare, setting
from stri_mapping.nodes.process import guarded, StopRequest, warn_of_unknown_parameters
from stri_mapping.nodes.raw_input import RawInput
from stri_mapping.recording.bag import DiskFullError, Recording
from stri_mapping.recording.definitions import Definitions
from stri_mapping.recording.repair import repair

# Seconds between two takes of what has gathered, which are also what a crash can cost at most.
TAKE_PERIOD = 0.1
# At the end: the bag is closed when nothing has come for so many seconds.
QUIET = 0.3


@dataclass(frozen=True)
class RecorderSettings:
    """
    What the recorder can be told.

    Attributes
    ----------
    path
        Directory of the bag, new.
    topics
        Topics to record, separated by spaces; empty for all.
    exclude
        Topics to leave out, separated by spaces; a name that ends in / leaves out all below it.
    split_size
        Megabytes after which a new file is begun; 0 for never.
    split_duration
        Seconds after which a new file is begun; 0 for never.
    resume
        Go on with the bag at the path, as after a crash, instead of refusing it.

    """

    path: str = ''
    topics: str = ''
    exclude: str = ''
    split_size: float = setting(0.0, 0.0, 1e9)
    split_duration: float = setting(0.0, 0.0, 1e9)
    resume: bool = False


class BagRecorder:
    """Subscribes to whatever is published, and writes it as it comes."""

    def __init__(self, stop: StopRequest) -> None:
        """Declare the parameters and make the bag."""
        self.node = Node('bag_recorder')
        self.settings = declare(self.node, RecorderSettings)
        warn_of_unknown_parameters(self.node)
        self._stop = stop
        self._recording = self._begin()
        self._input = RawInput(self.node, self.settings.topics, self.settings.exclude)
        self._started = time.monotonic()
        self._failure: DiskFullError | None = None
        self.node.create_timer(TAKE_PERIOD, self._take,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = Diagnostics(self.node, {'recording': self._report})

    def _begin(self) -> Recording:
        given = self.settings
        if not given.path:
            raise UsageError('parameter path: want the directory of a new bag')
        folder = Path(given.path)
        self._first = len(list(folder.glob('*.mcap'))) if given.resume else 0
        return Recording(folder, round(given.split_size * 1e6), round(given.split_duration * 1e9),
                         self._first)

    def run(self) -> None:
        """Record until asked to stop; DiskFullError when the disk is full."""
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        try:
            while not self._stop.requested and self._failure is None:
                executor.spin_once(timeout_sec=0.1)
            self._take_rest()
        finally:
            executor.shutdown()
            self._close()
        if self._failure is not None:
            raise self._failure

    def _take_rest(self) -> None:
        """Take what still arrives, until nothing has for a moment."""
        quiet = time.monotonic()
        while self._failure is None and time.monotonic() < quiet + QUIET:
            if self._take():
                quiet = time.monotonic()
            time.sleep(0.02)

    def _close(self) -> None:
        count = self._recording.count
        self._recording.close()
        if self._first:
            count = repair(self._recording.folder).messages
        self.node.get_logger().info(f'recorded {count} messages: {self._recording.folder}')

    def _take(self) -> bool:
        """Write what has gathered; return whether there was anything."""
        if self._failure is not None:
            return False
        count = self._recording.count
        try:
            for each in self._input.take():
                self._recording.write(each.topic, each.received_ns, each.sent_ns, each.data)
            self._recording.flush()
        except DiskFullError as error:
            self._failure = error
        return self._recording.count != count

    def _report(self) -> Report:
        recording = self._recording
        free = shutil.disk_usage(recording.folder).free
        values = {'Bag': recording.folder, 'Topics': len(self._input),
                  'Messages': recording.count, 'Megabytes left on the disk': f'{free / 1e6:.0f}',
                  'Seconds': f'{time.monotonic() - self._started:.0f}'}
        if not recording.count:
            return Report(WARN, 'nothing recorded yet', values)
        return Report(OK, 'recording', values)


def prepare() -> None:
    """Load the definitions of messages, so that a start is quick."""
    Definitions()


def main(args: list[str] | None = None) -> int:
    """Run the node until it is asked to stop."""
    return guarded(lambda stop: BagRecorder(stop).run(), args)


if __name__ == '__main__':
    sys.exit(main())
