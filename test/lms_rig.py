# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Drivers on emulated scanners whose every range tells which turn of the mirror measured it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
import threading
import time

import numpy as np

from stri_mapping.errors import LmsError
from stri_mapping.lms.driver import Driver
from stri_mapping.lms.settings import LmsSettings
from stri_mapping.lms.stamps import TimedScan
from stri_mapping.lms_emulator.device import EmulatedLms
from stri_mapping.lms_emulator.faults import Fault
from stri_mapping.lms_emulator.model import make_memory
from stri_mapping.lms_emulator.ports import Ports, PtyPort
from stri_mapping.lms_emulator.replies import Timing
from stri_mapping.lms_emulator.turns import Mirror, Turn

# Turns after which the ranges repeat.
CYCLE = 4000
# Seconds that a scanner takes to start; a real one takes up to 60.
START = 1.0
PPM = 100.0


def ranges_of(turn: int, bearings: np.ndarray) -> np.ndarray:
    """Return ranges in metres, whole centimetres, that no other turn of a cycle has."""
    return np.round(1.0 + 0.01 * (turn % CYCLE) + 0.1 * (np.floor(bearings + 1e-3) % 100 + 100), 2)


class Numbered:
    """A source of scans whose turns can be told apart."""

    def turn(self, number: int, bearings: np.ndarray) -> Turn:
        return Turn(ranges_of(number, bearings), 50.0 + 0.5 * bearings)


@dataclass
class Rig:
    """
    One scanner, its driver in a thread, and what it published.

    Attributes
    ----------
    got
        Steady time of publishing, and scan.

    """

    device: EmulatedLms
    port: PtyPort
    driver: Driver
    got: list[tuple[float, TimedScan]] = field(default_factory=list)
    attempts: int = 5
    failure: Exception | None = None

    def run(self) -> None:
        """Connect, trying again as the node does, and stream; the thread's body."""
        try:
            self._connect()
            self.driver.run(lambda scan: self.got.append((time.monotonic(), scan)))
        except Exception as error:
            self.failure = error

    def _connect(self) -> None:
        for left in reversed(range(self.attempts)):
            try:
                self.driver.connect()
                self.driver.start()
                return
            except LmsError:
                if not left:
                    raise

    def turns(self) -> list[int]:
        """Return the mirror turn of every scan, checking each of its ranges."""
        found = []
        for _, timed in self.got:
            bearings = timed.scan.first - 90.0 + timed.scan.step * np.arange(
                len(timed.scan.ranges))
            offset = ranges_of(0, bearings[:1])[0]
            turn = round(100.0 * (timed.scan.ranges[0] - offset))
            assert np.allclose(timed.scan.ranges, ranges_of(turn, bearings), atol=1e-6)
            found.append(turn)
        return found

    def stamp_errors(self) -> np.ndarray:
        """Return, in seconds, stamps minus the times at which the first rays were sent."""
        offset = time.time() - time.monotonic()
        errors = []
        for turn, (_, timed) in zip(self.turns(), self.got):
            steady = 1e-9 * timed.stamp_ns - offset
            first = self.device.mirror.begin(turn) + (
                self.device.mirror.period * timed.scan.first / 360.0)
            cycle = CYCLE * self.device.mirror.period
            errors.append((steady - first + cycle / 2) % cycle - cycle / 2)
        return np.array(errors)

    def since(self, moment: float) -> float | None:
        """Return the seconds from a moment to the first scan published after it."""
        return next((at - moment for at, _ in self.got if at > moment), None)


@contextmanager
def rigs(folder: Path, plans: dict[str, Iterable[Fault]], rate: int = 500000,
         streaming: bool = False, model: str = 'LMS291', attempts: int = 5, **wanted: object,
         ) -> Iterator[tuple[Ports, dict[str, Rig]]]:
    """Give a rig for each plan of faults; in the end every scanner is left as a user expects."""
    end = threading.Event()
    made: dict[str, Rig] = {}
    for name, faults in plans.items():
        begin = time.monotonic()
        device = EmulatedLms(
            Numbered(), make_memory(model, rate, streaming), begin=begin, faults=faults,
            mirror=Mirror(begin, 13.32e-3 * (1.0 + 1e-6 * PPM)), timing=Timing(start=START))
        port = PtyPort(folder / name, device)
        settings = LmsSettings(**{'serial_port': str(folder / name), **wanted})  # type: ignore[arg-type]
        made[name] = Rig(device, port, Driver(settings, end.is_set), attempts=attempts)
    with Ports(tuple(rig.port for rig in made.values())) as ports:
        threads = [threading.Thread(target=rig.run) for rig in made.values()]
        for thread in threads:
            thread.start()
        try:
            yield ports, made
        finally:
            end.set()
            for thread, rig in zip(threads, made.values()):
                thread.join()
                rig.driver.leave()
    for rig in made.values():
        if rig.failure is not None:
            raise rig.failure


def inject(ports: Ports, rig: Rig, fault: Fault) -> float:
    """Let something go wrong now; return when it is over and the scanner ready, steady time."""
    now = time.monotonic()
    ports.post(lambda: rig.device.inject(fault, time.monotonic()))
    over = now if fault.kind == 'reset' else now + fault.duration
    return over + START if fault.kind in ('reset', 'power_cycle') else over


def wait(condition: Callable[[], object], what: str, patience: float = 60.0) -> None:
    """Wait for a condition; fail, naming it, where something hangs."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, f'never came: {what}'
        time.sleep(0.02)
