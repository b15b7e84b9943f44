# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The process of emulated scanners: its loop, and what it exchanges with the one that feeds."""

from __future__ import annotations

import gc
from multiprocessing.connection import Connection
import signal
import sys
from threading import Thread
import time
import traceback

from stri_mapping.errors import LmsError
from stri_mapping.lms.requests import EVERY_TURN
from stri_mapping.lms_emulator.device import EmulatedLms
from stri_mapping.lms_emulator.ports import Ports, PtyPort
from stri_mapping.lms_emulator.priority import before_others
from stri_mapping.lms_emulator.process import State, STATE_PERIOD, Turns, Want
from stri_mapping.lms_emulator.turns import Array, Turn

# Turns kept for each scanner: some seconds.
KEPT = 400
# Seconds after the end, at most, for hosts that stop their scanners.
LINGER = 15.0


class _Feed:
    """Turns by their numbers; a `TurnSource`."""

    def __init__(self) -> None:
        self._turns: dict[int, tuple[float, Turn]] = {}
        self._newest: dict[tuple[float, int], Turn] = {}    # by first bearing and rays
        self.at_rest = False

    def turn(self, number: int, bearings: Array) -> Turn | None:
        """Return a turn, if it has come and is what the scanner measures."""
        first, turn = self._turns.get(number, (0.0, None))
        if turn is not None and len(turn.ranges) == len(bearings) and first == bearings[0]:
            return turn
        return self._newest.get((bearings[0], len(bearings))) if self.at_rest else None

    def add(self, turns: Turns) -> None:
        """Take turns in, and forget old ones."""
        for k, ranges in enumerate(turns.ranges):
            number = turns.first + k
            first = turns.want.first_bearing(number)
            turn = Turn(ranges, None if turns.remission is None else turns.remission[k])
            self._turns[number] = first, turn
            self._newest[first, len(ranges)] = turn
        for number in [n for n in self._turns if n < turns.first - KEPT]:
            del self._turns[number]


class _Server:
    """The loop over the ports, and beside it a thread that takes in what is fed."""

    def __init__(self, connection: Connection) -> None:
        folder, setups, adapter = connection.recv()
        self._connection = connection
        self._feeds = [_Feed() for _ in setups]
        begin = time.monotonic()
        self._devices = [EmulatedLms(
            feed, setup.memory, mirror=setup.mirror, adapter=adapter, faults=setup.faults,
            begin=begin, seed=setup.seed) for feed, setup in zip(self._feeds, setups)]
        self._ports = Ports(tuple(PtyPort(folder / setup.name, device)
                                  for setup, device in zip(setups, self._devices)))
        self._first = before_others()
        self._end: float | None = None          # when hosts have had time to stop their scanners

    def run(self) -> None:
        """Serve until the feeding process is gone, or after its orderly end all hosts."""
        Thread(target=self._take, name='feed', daemon=True).start()
        try:
            self._ports.every(STATE_PERIOD, self._look)
            self._ports.run()
        finally:
            self._ports.close()

    def _take(self) -> None:
        """Take in what is fed; to wait for it in the loop would make bytes late."""
        try:
            while isinstance(message := self._connection.recv(), Turns):
                self._feeds[message.scanner].add(message)
        except (EOFError, OSError):
            self._ports.stop()
            return
        for feed in self._feeds:
            feed.at_rest = message
        self._end = time.monotonic() + LINGER

    def _look(self) -> None:
        if self._end is None or not self._connection.closed:
            self._tell()
        elif time.monotonic() > self._end or not any(p.opened for p in self._ports.ports):
            self._ports.stop()

    def _tell(self) -> None:
        """Send the state, after the end for the last time."""
        over = self._end is not None
        try:
            self._connection.send(State(
                tuple(map(_want, self._devices)),
                tuple(device.counts.scans for device in self._devices),
                tuple(device.counts.starved for device in self._devices),
                self._ports.lateness.figures, self._first, time.process_time()))
        except OSError:
            self._ports.stop()
        if over:
            self._connection.close()


def _want(device: EmulatedLms) -> Want | None:
    if not device.streaming:
        return None
    variant = device.memory.variant
    wide = device.memory.mode == EVERY_TURN
    return Want(180.0 if wide else float(variant.angle), 0.01 * variant.resolution)


def main() -> None:
    """Emulate for the process at the other end of the socket whose number is the argument."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)       # the end comes from that process
    connection = Connection(int(sys.argv[1]))
    try:
        server = _Server(connection)
        gc.freeze()
        server.run()
    except LmsError as error:
        connection.send(str(error))
    except Exception:
        connection.send('the emulated scanners failed: ' + traceback.format_exc())
        raise


if __name__ == '__main__':
    main()
