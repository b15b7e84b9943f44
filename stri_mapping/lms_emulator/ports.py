# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Emulated scanners behind pseudo terminals, at true times, any number in one loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import math
import os
from pathlib import Path
import select
import selectors
import socket
import termios
import threading
import time
import tty
from types import TracebackType
from typing import Any

from stri_mapping.errors import LmsError
from stri_mapping.lms.telegram import crc
from stri_mapping.lms_emulator.device import EmulatedLms
from stri_mapping.lms_emulator.lateness import Lateness

# Rates by the constants that tcgetattr gives.
RATES = {getattr(termios, f'B{rate}'): rate for rate in (
    1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 500000, 921600)}
# Seconds between two looks at whether somebody has opened a port that nobody has open.
LOOK = 0.02
READ_SIZE = 4096


class PtyPort:
    """
    One scanner behind one pseudo terminal, which a symbolic link names.

    While nobody has the port open, what the scanner sends is lost, as on a real line.

    Parameters
    ----------
    link
        Path of the link; a link that is there already is replaced.
    device
        The scanner, in the times of `time.monotonic`.

    Attributes
    ----------
    opened
        Whether a host has the port open.

    """

    def __init__(self, link: Path, device: EmulatedLms) -> None:
        """Do nothing yet: `plug` makes the port."""
        self.link, self.device = link, device
        self.opened = False
        self.lost_bytes = 0             # that the host did not fetch in time
        self.fd: int | None = None
        self.due = -math.inf            # when `serve` should next be called
        self._name = ''
        self._look = -math.inf

    def plug(self) -> None:
        """
        Make terminal and link.

        Raises
        ------
        LmsError
            If the link cannot be made.

        """
        self.fd, slave = os.openpty()
        tty.setraw(slave)
        self._name, self.due = os.ttyname(slave), -math.inf
        os.close(slave)
        os.set_blocking(self.fd, False)
        try:
            if self.link.exists() and not self.link.is_symlink():
                raise LmsError(f'{self.link}: is there already and no link; name a new path')
            fresh = self.link.with_name(f'.{self.link.name}.{os.getpid()}')
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self._name)
            fresh.replace(self.link)
        except OSError as error:
            raise LmsError(f'{self.link}: no link can be made: {error.strerror}') from None

    def unplug(self) -> None:
        """Take terminal and link away; a link that somebody else has renewed stays."""
        if self.fd is None:
            return
        os.close(self.fd)
        self.fd, self.opened, self.due = None, False, -math.inf
        try:
            if os.readlink(self.link) == self._name:
                self.link.unlink()
        except OSError:                 # it is gone already
            pass

    def read(self, now: float) -> None:
        """Pass on what the host has sent."""
        assert self.fd is not None
        try:
            data = os.read(self.fd, READ_SIZE)
        except BlockingIOError:
            return
        except OSError:                 # the last host has closed it
            self._closed(now)
            return
        self.device.receive(data, now, self._rate())
        self._plan()

    def _plan(self) -> None:
        due = self.device.next_due
        self.due = due if self.opened or self.fd is None else min(due, self._look)

    def serve(self, now: float, lateness: Lateness) -> None:
        """Pass on what is due for the host."""
        if self.fd is not None and not self.opened and self._look <= now:
            self._look = now + LOOK
            poll = select.poll()
            poll.register(self.fd, select.POLLIN)
            events = sum(event for _, event in poll.poll(0))
            self.opened = not events & select.POLLHUP
            if events & select.POLLIN:      # perhaps of a host that has closed it already
                self.read(now)
        rate = self._rate() if self.opened else 0
        for due, data, _ in self.device.arrivals(now, rate):
            if self.opened and data:
                self._write(data)
                lateness.add(time.monotonic() - due)
        self._plan()

    def _write(self, data: bytes) -> None:
        assert self.fd is not None
        try:
            written = os.write(self.fd, data)
        except OSError:                 # the host does not fetch, or has just closed it
            written = 0
        self.lost_bytes += len(data) - written

    def _rate(self) -> int:
        """Return the rate to which the host has set the port; 0 for one no scanner knows."""
        assert self.fd is not None
        try:
            return RATES.get(termios.tcgetattr(self.fd)[5], 0)
        except termios.error:
            return 0

    def _closed(self, now: float) -> None:
        """Forget what the host left unread, so that the next one does not find it."""
        self.opened, self._look = False, now + LOOK
        self._plan()
        try:
            slave = os.open(self._name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:
            return
        try:
            termios.tcflush(slave, termios.TCIOFLUSH)
        finally:
            os.close(slave)


@dataclass
class Ports:
    """
    A loop that serves some ports; it runs in the calling thread or, as a context, in its own.

    Attributes
    ----------
    ports
        What it serves.
    lateness
        Of bytes against the times at which they should have reached the host.

    """

    ports: tuple[PtyPort, ...]
    lateness: Lateness = field(default_factory=Lateness)

    def __post_init__(self) -> None:
        """Make all ports."""
        self._selector = selectors.SelectSelector()     # the one that waits for microseconds
        self._wake, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._selector.register(self._woken, selectors.EVENT_READ, self._wake_up)
        self._posted: list[Callable[[], None]] = []
        self._selected: dict[PtyPort, int] = {}
        self._timer: tuple[float, Callable[[], None]] | None = None
        self._timer_due = -math.inf
        self._stopped = False
        self._thread: threading.Thread | None = None
        crc(b'')                        # makes its table now and not at the first scan
        try:
            for port in self.ports:
                port.plug()
        except LmsError:
            self.close()
            raise

    def __enter__(self) -> Ports:
        """Serve in a thread."""
        self._thread = threading.Thread(target=self.run, name='emulated scanners', daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """End the thread, take the ports away."""
        self.stop()
        if self._thread is not None:
            self._thread.join()
        self.close()

    def run(self) -> None:
        """Serve until stopped."""
        while not self._stopped:
            now = time.monotonic()
            due = self._run_timer(now)
            for port in self.ports:
                if port.due <= now:
                    self._serve(port, now)
                due = min(due, port.due)
            wait = None if due == math.inf else max(0.0, due - time.monotonic())
            for key, _ in self._selector.select(wait):
                key.data()

    def stop(self) -> None:
        """End `run`; from any thread or a signal handler."""
        self._stopped = True
        self.post(lambda: None)

    def post(self, action: Callable[[], None]) -> None:
        """Let the loop do something soon, such as to inject a fault; from any thread."""
        self._posted.append(action)
        self._wake.send(b'.')

    def watch(self, file: Any, action: Callable[[], None]) -> None:
        """Do something whenever a file can be read."""
        self._selector.register(file, selectors.EVENT_READ, action)

    def unwatch(self, file: Any) -> None:
        """Watch a file no more."""
        self._selector.unregister(file)

    def every(self, period: float, action: Callable[[], None]) -> None:
        """Do something every so many seconds; there is one such thing."""
        self._timer = (period, action)

    def close(self) -> None:
        """Take all ports away."""
        for port in self.ports:
            port.unplug()
        self._selector.close()
        self._wake.close()
        self._woken.close()

    def _run_timer(self, now: float) -> float:
        """Do what is to be done now and then; return when it is due again."""
        if self._timer is None:
            return math.inf
        period, action = self._timer
        if self._timer_due <= now:
            self._timer_due = now + period
            action()
        return self._timer_due

    def _wake_up(self) -> None:
        self._woken.recv(READ_SIZE)
        while self._posted:
            self._posted.pop(0)()
        for port in self.ports:         # they may be due earlier now
            port.due = -math.inf

    def _serve(self, port: PtyPort, now: float) -> None:
        port.serve(now, self.lateness)
        present = port.device.present(now)
        if present != (port.fd is not None):
            if present:
                port.plug()
            else:
                port.unplug()
        self._select(port)

    def _select(self, port: PtyPort) -> None:
        """Wait for a port's bytes exactly while a host has it open."""
        wanted = port.fd if port.opened else None
        selected = self._selected.get(port)
        if wanted == selected:
            return
        if selected is not None:
            del self._selected[port]
            self._selector.unregister(selected)
        if wanted is not None:
            self._selected[port] = wanted
            self._selector.register(wanted, selectors.EVENT_READ, lambda: self._read(port))

    def _read(self, port: PtyPort) -> None:
        port.read(time.monotonic())
        self._select(port)
