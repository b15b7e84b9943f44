# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node: one SICK LMS 2xx on a serial port, one LaserScan a mirror turn."""

from __future__ import annotations

from dataclasses import dataclass
import sys
import threading
import time

from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import LaserScan

from stri_mapping.errors import LmsError, LmsSettingError
from stri_mapping.lms.device import CancelledError, TRIES
from stri_mapping.lms.driver import Driver
from stri_mapping.lms.report import report_values
from stri_mapping.lms.settings import LmsSettings
from stri_mapping.lms.stamps import TimedScan
from stri_mapping.lms.status import POLLUTED
from stri_mapping.nodes.conversions import scan_message
from stri_mapping.nodes.diagnostics import Diagnostics, ERROR, OK, Report, WARN
from stri_mapping.nodes.parameters import declare
from stri_mapping.nodes.process import guarded, StopRequest, warn_of_unknown_parameters
from stri_mapping.nodes.qos import advertise

# Seconds between attempts to configure where the node starts itself.
RETRY = 0.2
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


@dataclass(frozen=True)
class DriverSettings(LmsSettings):
    """
    What the node can be told.

    Attributes
    ----------
    frame_id
        Frame of the scans: x along the 0 degree ray, y along the 90 degree ray.
    self_start
        Whether the node configures and activates itself, for use without a lifecycle manager.

    """

    frame_id: str = 'laser'
    self_start: bool = False


class SickLmsDriver(LifecycleNode):
    """Configured, it has found and set up the scanner; active, it publishes."""

    def __init__(self, stop: StopRequest) -> None:
        """Declare the parameters; the port is opened by configuring."""
        super().__init__('sick_lms_driver')
        self.settings = declare(self, DriverSettings)
        self.finished = False                   # the reader has ended by itself
        self.error: Exception | None = None     # with which the process is to end
        self._halt = threading.Event()
        self._driver = Driver(self.settings, lambda: stop.requested or self._halt.is_set())
        self._reader: threading.Thread | None = None
        self._fault: str | None = None          # why configuring or activating failed
        self._reported = (time.monotonic(), 0)
        self._publisher = advertise(self, LaserScan, 'scan', 10, self.create_lifecycle_publisher)
        warn_of_unknown_parameters(self)
        self._diagnostics = Diagnostics(self, {'scanner': self._report})

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the port, find the scanner and set it up."""
        try:
            # one round, where it will be tried again anyway, so that this does not block for long
            self._driver.connect(rounds=1 if self.settings.self_start else TRIES)
        except LmsError as error:
            return self._failed(error)
        assert self._driver.identity is not None
        self._diagnostics.hardware = self._driver.identity.status.serial_number.strip()
        self._fault = None
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the scanner stream, and publish."""
        try:
            self._driver.start()
        except LmsError as error:
            return self._failed(error)
        self._fault = None
        super().on_activate(state)
        self._reader = threading.Thread(target=self._read, name='reader')
        self._reader.start()
        return SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the scanner fall silent."""
        self._end_reader()
        try:
            self._driver.stop()
        except LmsError as error:
            self.get_logger().warning(str(error))
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the scanner as after power-on, and close the port."""
        self.leave()
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the scanner as after power-on, and close the port."""
        self.leave()
        return SUCCESS

    def leave(self) -> None:
        """Leave the scanner silent at 9600 Bd, and close the port."""
        self._end_reader()
        self._driver.leave()

    def start(self) -> bool:
        """Configure and activate; return whether that succeeded."""
        if self.trigger_configure() != SUCCESS:
            return False
        if self.trigger_activate() != SUCCESS:
            self.trigger_cleanup()
            return False
        return True

    def _failed(self, error: LmsError) -> TransitionCallbackReturn:
        """Say, once, why a transition failed."""
        if self.settings.self_start and isinstance(error, LmsSettingError):
            self.error = error              # trying again would not help
        elif str(error) != self._fault and not isinstance(error, CancelledError):
            self._fault = str(error)
            self.get_logger().error(self._fault)
        return FAILURE

    def _read(self) -> None:
        """Publish scan by scan, in a thread of its own."""
        try:
            self._driver.run(self._publish)
        except Exception as error:      # a fault of ours: the main thread has to fail with it
            self.error = error
        self.finished = not self._halt.is_set()

    def _publish(self, timed: TimedScan) -> None:
        self._publisher.publish(scan_message(
            timed, self.settings.frame_id, self.settings.publish_intensity))

    def _end_reader(self) -> None:
        if self._reader is not None:
            self._halt.set()
            self._reader.join()
            self._halt.clear()
            self._reader = None

    def _report(self) -> Report:
        values = report_values(self._driver)
        values['Rate'] = f'{self._rate():.2f} Hz'
        if self._fault is not None and not self._driver.streaming:
            return Report(ERROR, self._fault, values)
        if not self._driver.streaming:
            return Report(WARN, self._driver.state, values)
        if self._driver.status & POLLUTED:
            return Report(WARN, 'front window polluted', values)
        return Report(OK, self._driver.state, values)

    def _rate(self) -> float:
        """Return the scans a second since the last report."""
        (then, before), now = self._reported, time.monotonic()
        self._reported = now, self._driver.stamper.dated
        return (self._reported[1] - before) / max(now - then, 1e-3)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return guarded(_run, args)


def _run(stop: StopRequest) -> None:
    node = SickLmsDriver(stop)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    waiting, again = node.settings.self_start, 0.0
    try:
        while not (stop.requested or node.finished or node.error):
            if waiting and time.monotonic() >= again:
                waiting, again = not node.start(), time.monotonic() + RETRY
            executor.spin_once(timeout_sec=0.1)
        if node.error is not None:
            raise node.error
    finally:
        node.leave()
        executor.shutdown()
        node.destroy_node()


if __name__ == '__main__':
    sys.exit(main())
