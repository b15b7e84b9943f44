# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A port and the telegrams on it: paced sending, and receiving with few wake-ups."""

from __future__ import annotations

from collections.abc import Callable
import os
import select
import time
from typing import Any, cast

from stri_mapping.errors import LmsError
from stri_mapping.lms.parser import Handshake, LineCounts, Parser, Received
from stri_mapping.lms.port import Port
from stri_mapping.lms.telegram import ANY_SCANNER, frame

BYTE_BITS = 10
# Above this rate, bytes sent without a pause come closer together than a scanner takes them
# (at least 55 us): so many nanoseconds from one to the next.
PACED_ABOVE, PACE_NS = 38400, 60_000
# Seconds to sleep at most while a telegram is coming in; the rest of it is then read at once.
NAP = 0.05
READ_SIZE, MOST_READS = 65536, 64
# Seconds that a port waits for a byte which cannot be polled.
PATIENCE = 0.02


class Line:
    """
    The line to one scanner.

    Parameters
    ----------
    port
        Anything with read and write, see `Port`.
    name
        Names the port in errors.
    counts
        What was met on the line is counted there.
    clock_ns
        Steady clock of arrivals, nanoseconds.

    Attributes
    ----------
    listener
        Given the bytes and the time of every read in `receive`.
    adjustable
        Whether the port's rate can be set.

    """

    def __init__(
        self,
        port: Port,
        name: str = 'port',
        counts: LineCounts | None = None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Take over an open port."""
        self.name = name
        self._port = cast(Any, port)
        self._clock_ns = clock_ns
        self.listener: Callable[[bytes, int], object] | None = None
        self.counts = LineCounts() if counts is None else counts
        self._parser = Parser(counts=self.counts)
        self._file = _file_number(port)
        self._poll = None
        if self._file is None and hasattr(port, 'timeout'):
            self._port.timeout = PATIENCE       # once: gateways negotiate each change
        elif self._file is not None:
            self._poll = select.poll()
            self._poll.register(self._file, select.POLLIN)
        # a network gateway's rate is its own affair; objects without `baudrate` have none
        self.adjustable = hasattr(port, 'baudrate') and not name.startswith('socket://')
        self._rate = 0
        self._set_byte_time(getattr(port, 'baudrate', 0) if self.adjustable else 0)

    @property
    def rate(self) -> int:
        """Line rate in baud; 0 where it is not known."""
        return self._rate

    @rate.setter
    def rate(self, rate: int) -> None:
        """Change it, or believe it where the port has none of its own; raises LmsError."""
        if self.adjustable:
            try:
                self._port.baudrate = rate
            except (OSError, ValueError) as error:
                raise LmsError(f'{self.name} cannot do {rate} Bd ({error}): 500000 Bd needs an '
                               'RS-422 adapter whose chip divides to it, such as an FTDI'
                               ) from None
        self._set_byte_time(rate)

    def _set_byte_time(self, rate: int) -> None:
        self._rate = rate
        self._parser.byte_ns = BYTE_BITS * 1_000_000_000 // rate if rate else 0

    def send(self, payload: bytes, address: int = ANY_SCANNER) -> None:
        """Send one telegram; raises LmsError if the port is gone."""
        data = frame(payload, address)
        try:
            # a network has its own idea of the pauses between bytes
            if self._rate > PACED_ABOVE and self.adjustable and self._file is not None:
                for byte in data:
                    due = time.perf_counter_ns() + PACE_NS
                    self._write(bytes((byte,)))
                    while time.perf_counter_ns() < due:     # far below what sleep can do
                        pass
            else:
                self._write(data)
        except (OSError, ValueError) as error:
            raise self._gone(error) from None

    def _write(self, data: bytes) -> None:
        if self._file is None:
            self._port.write(data)
        elif os.write(self._file, data) != len(data):
            raise OSError('its output is blocked')

    def receive(self, timeout: float) -> list[Received | Handshake]:
        """
        Wait for bytes and return the telegrams that they complete, in order.

        Parameters
        ----------
        timeout
            Seconds to wait for the first byte.

        Returns
        -------
        list
            Empty also where bytes came that complete nothing.

        Raises
        ------
        LmsError
            If the port is gone.

        """
        try:
            data = self._read(timeout)
        except (OSError, ValueError, TypeError) as error:
            raise self._gone(error) from None
        if not data:
            return self._parser.idle()
        now_ns = self._clock_ns()
        if self.listener is not None:
            self.listener(data, now_ns)
        found = self._parser.feed(data, now_ns)
        if not found and self._file is not None and self._parser.missing:
            time.sleep(min(1e-9 * self._parser.missing * self._parser.byte_ns, NAP))
        return found

    def _read(self, timeout: float) -> bytes:
        if self._poll is None:
            return self._read_patiently(time.monotonic() + timeout)
        assert self._file is not None
        if not self._poll.poll(1000.0 * timeout):
            return b''
        try:
            data = os.read(self._file, READ_SIZE)
        except BlockingIOError:
            return b''
        if not data:
            raise OSError('end of file')
        return data

    def _read_patiently(self, end: float) -> bytes:
        """Return what comes until a time, of a port that cannot be polled."""
        while True:
            waiting = getattr(self._port, 'in_waiting', 0)
            data = bytes(self._port.read(waiting or 1))
            if data or time.monotonic() >= end:
                return data

    def flush(self) -> None:
        """Throw away what has come in but was not yet received."""
        try:
            for _ in range(MOST_READS):         # a port that never runs dry is none of a scanner
                if not self._read(0.0):
                    break
        except (OSError, ValueError, TypeError) as error:
            raise self._gone(error) from None
        self._parser.clear()

    def close(self) -> None:
        """Close the port."""
        close = getattr(self._port, 'close', None)
        if close is not None:
            try:
                close()
            except OSError:             # it is gone already
                pass

    def _gone(self, error: Exception) -> LmsError:
        return LmsError(f'{self.name}: the port is gone ({error})')


def _file_number(port: Any) -> int | None:
    """Return the file descriptor to wait on; None for ports that have none."""
    try:
        return int(port.fileno())
    except (AttributeError, OSError, ValueError, NotImplementedError):
        return None
