# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Life of a node's process: start, spin, and an end that loses nothing.

The first SIGINT or SIGTERM asks for the end: the node still takes what has already reached its
readers, finishes its computation, publishes and writes the rest.  The second one kills.  SIGHUP,
the end of terminal or supervisor, only asks.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
import ctypes
import gc
import logging
import math
import os
import signal
import sys
import time
from types import FrameType
from typing import Protocol

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import ROSInterruptException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from stri_mapping.errors import EXIT_CRASH, EXIT_DATA, EXIT_USAGE, StriMappingError, UsageError
from stri_mapping.node_process import SUPERVISOR_VARIABLE
from stri_mapping.nodes.scan_input import AT_ONCE, ScanInput

PR_SET_PDEATHSIG = 1
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# Seconds a subscriber may take to acknowledge the last messages before it is given up.
ACKNOWLEDGE = Duration(seconds=10)
# Seconds a node that was stopped waits for the end of those that feed it: all may be stopped at
# once, and the last poses come when the estimator has finished.
PATIENCE = 3.0
# Seconds after which a node that was stopped ends although something still comes; less than what
# the supervisor allows.
REST = 60.0
# Seconds between two turns of everything of a node but its scans.
TURN = 0.1
# Seconds without anything new after which readers count as empty.
QUIET = 0.2


class ProcessingNode(Protocol):
    """What `run_node` needs: a node, and what is to be done once no message will come."""

    @property
    def node(self) -> Node:
        """The ROS node."""

    @property
    def inputs(self) -> Sequence[ScanInput]:
        """Scans, to be taken now and then."""

    @property
    def prompt(self) -> ScanInput | None:
        """That of them whose scans are to be taken as they come, if any."""

    @property
    def upstream(self) -> Collection[str]:
        """Topics on which something may come until their publishers have ended as well."""

    def finish(self) -> None:
        """Finish the computation, publish and write the rest."""


class StopRequest:
    """Whether a signal came that asks for the end; a second SIGINT or SIGTERM kills."""

    def __init__(self) -> None:
        """Install the handlers."""
        self.requested = False
        for number in (*STOP_SIGNALS, signal.SIGHUP):
            signal.signal(number, self._request)

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested = True
        if number in STOP_SIGNALS:
            for each in STOP_SIGNALS:
                signal.signal(each, signal.SIG_DFL)


def follow_supervisor() -> None:
    """Ask the kernel for a SIGHUP when the supervisor dies, however it dies."""
    supervisor = os.environ.get(SUPERVISOR_VARIABLE)
    if supervisor is None or not sys.platform.startswith('linux'):
        return
    # it comes once for every thread the supervisor had: never a signal whose second one kills
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGHUP)
    if os.getppid() != int(supervisor):         # it died before the call above
        signal.raise_signal(signal.SIGHUP)


def run_node(make: Callable[[], ProcessingNode], args: list[str] | None = None) -> int:
    """
    Run one node until it is asked to stop; return the exit code of its process.

    Parameters
    ----------
    make
        Makes the node once ROS is up.
    args
        Command line; that of the process by default.

    """
    return guarded(lambda stop: _spin(make, stop), args)


def guarded(body: Callable[[StopRequest], None], args: list[str] | None = None) -> int:
    """Run a body between the start and the end of ROS; return an exit code, log errors."""
    logging.basicConfig(level=logging.INFO, format='%(levelname)s: %(message)s')
    stop = StopRequest()
    follow_supervisor()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        body(stop)
    except StriMappingError as error:
        logging.error('%s', error)
        return EXIT_USAGE if isinstance(error, UsageError) else EXIT_DATA
    except (KeyboardInterrupt, ExternalShutdownException, ROSInterruptException):
        return EXIT_DATA
    except Exception:               # a fault of ours: told whole, and the node started again
        logging.exception('this is a fault of the program')
        return EXIT_CRASH
    finally:
        rclpy.try_shutdown()
    return 0


def _spin(make: Callable[[], ProcessingNode], stop: StopRequest) -> None:
    processing = make()
    gc.freeze()         # what is there stays; to look through it takes 30 to 50 ms each time
    warn_of_unknown_parameters(processing.node)
    executor = SingleThreadedExecutor()
    executor.add_node(processing.node)
    try:
        due, taken = 0.0, 0
        while not stop.requested:
            if processing.prompt is None:
                executor.spin_once(timeout_sec=TURN if taken < AT_ONCE else 0.0)
            else:
                processing.prompt.wait(TURN)
                if time.monotonic() > due:
                    due = time.monotonic() + TURN
                    _run_ready(executor, 0.0)
            taken = _take(processing)
        until = time.monotonic() + REST
        _take_rest(processing, executor, until)
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and any(
                processing.node.count_publishers(topic) for topic in processing.upstream):
            _take_rest(processing, executor, until)
        processing.finish()
        for publisher in processing.node.publishers:
            publisher.wait_for_all_acked(ACKNOWLEDGE)
    finally:
        executor.shutdown()
        processing.node.destroy_node()


def _take(processing: ProcessingNode) -> int:
    """Take scans that have gathered; return the most that one scanner had."""
    return max([each.take() for each in processing.inputs], default=0)


def _run_ready(
    executor: SingleThreadedExecutor, quiet: float, until: float = math.inf,
) -> bool:
    """Run callbacks until none has been ready for some seconds; return whether any was."""
    ran = False
    while time.monotonic() < until:
        try:
            callback, _, _ = executor.wait_for_ready_callbacks(timeout_sec=quiet)
        except TimeoutException:
            break
        callback()
        callback.result()
        ran = True
    return ran


def _take_rest(
    processing: ProcessingNode, executor: SingleThreadedExecutor, until: float,
) -> None:
    """Run callbacks and take scans until nothing has come for a moment, or time is up."""
    while _run_ready(executor, QUIET, until) + _take(processing):
        if time.monotonic() >= until:
            processing.node.get_logger().warning(
                f'something still comes {REST:.0f} s after the end was asked for: it ends now')
            return


def warn_of_unknown_parameters(node: Node) -> None:
    """Say which of the parameters given are not the node's: misspelt, they have no effect."""
    # rclpy has no public way to ask what was given
    for name in node._parameter_overrides:
        if not node.has_parameter(name):
            node.get_logger().warning(f'parameter {name} is unknown and has no effect')
