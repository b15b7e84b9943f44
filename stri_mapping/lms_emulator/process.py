# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Emulated scanners in a process of their own, fed with turns by the process that started it.

What else that process does cannot make a byte late: neither shares the other's interpreter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
import socket
import subprocess
import sys
from typing import Any, NamedTuple

from numpy.typing import NDArray

from stri_mapping.errors import LmsError
from stri_mapping.lms_emulator.faults import Fault
from stri_mapping.lms_emulator.lateness import Figures
from stri_mapping.lms_emulator.line import Adapter
from stri_mapping.lms_emulator.model import Memory
from stri_mapping.lms_emulator.turns import Mirror

# Seconds between two states.
STATE_PERIOD = 0.1
# Seconds within which the process ends when it is left alone: far more than it takes.
PATIENCE = 30.0
SERVER = 'stri_mapping.lms_emulator.server'


@dataclass(frozen=True)
class Setup:
    """One scanner: the name of its port's link, its mirror, its state at the start, its faults."""

    name: str
    mirror: Mirror
    memory: Memory
    faults: Sequence[Fault] = ()
    seed: int = 0


class Want(NamedTuple):
    """What a scanner measures: the arc and the resolution in degrees."""

    field: float
    resolution: float

    def first_bearing(self, number: int) -> float:
        """Return the bearing in degrees at which a turn begins."""
        return -0.5 * self.field + number % round(1.0 / self.resolution) * self.resolution


class Turns(NamedTuple):
    """Message to the process: consecutive turns of one scanner, as `Turn` has them."""

    scanner: int
    want: Want
    first: int
    ranges: Sequence[NDArray[Any]]
    remission: Sequence[NDArray[Any]] | None


@dataclass(frozen=True)
class State:
    """
    Message from the process.

    Attributes
    ----------
    wants
        Of each scanner, None while it does not stream.
    scans, starved
        Scans sent by each, and scans that it had to leave out because no turns had come.
    lateness
        Of all bytes.
    real_time
        Whether the process runs before all others.
    processor_s
        Seconds of processor time it took.

    """

    wants: tuple[Want | None, ...] = ()
    scans: tuple[int, ...] = ()
    starved: tuple[int, ...] = ()
    lateness: Figures = Figures()
    real_time: bool = False
    processor_s: float = 0.0


class EmulatorProcess:
    """
    The side of the process that feeds; a context manager.

    Attributes
    ----------
    state
        The last one that came.

    """

    def __init__(self, folder: Path, setups: Sequence[Setup], adapter: Adapter) -> None:
        """Start the process; the links are in `folder` soon after."""
        here, there = socket.socketpair()
        self._process = subprocess.Popen(
            [sys.executable, '-m', SERVER, str(there.fileno())], pass_fds=[there.fileno()],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        there.close()
        self._connection = Connection(here.detach())
        self._guarded(lambda: self._connection.send((folder, tuple(setups), adapter)))
        self._ended = False
        self.state = State((None,) * len(setups))

    def __enter__(self) -> EmulatorProcess:
        """Return the process."""
        return self

    def __exit__(self, *_: object) -> None:
        """Take the ports away, at once if `end` was not called."""
        self._connection.close()
        if not self._ended:
            self._process.wait(PATIENCE)

    def feed(self, turns: Turns) -> None:
        """Hand turns on."""
        self._guarded(lambda: self._connection.send(turns))

    def poll(self, timeout: float = 0.0) -> State:
        """
        Take in what has come, and return the last state.

        Raises
        ------
        LmsError
            If the process failed.

        """
        self._guarded(lambda: self._receive(timeout))
        return self.state

    def end(self, at_rest: bool) -> State:
        """
        Let the ports live on until all hosts have closed them; return the last state.

        Parameters
        ----------
        at_rest
            Whether nothing moves any more: then the scanners go on sending the same scans, else
            none.  In both cases hosts can still make them stop.

        """
        self._guarded(lambda: self._connection.send(at_rest))
        self._ended = True
        try:
            for _ in range(20):         # the process closes its end after its last state
                self._receive(STATE_PERIOD)
        except (EOFError, OSError):
            pass
        return self.state

    def _receive(self, timeout: float) -> None:
        while self._connection.poll(timeout):
            message = self._connection.recv()
            if isinstance(message, str):
                raise LmsError(message)
            self.state = message
            timeout = 0.0

    def _guarded(self, action: Any) -> None:
        try:
            action()
        except (EOFError, OSError):
            raise LmsError('the process of the emulated scanners has ended, with exit code '
                           f'{self._process.wait(PATIENCE)}') from None
