# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Bytes on their way from a scanner to the host: the serial line and the adapter at its end."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import NamedTuple

# Bit times a byte takes: start, 8 data bits, stop.
BITS = 10


@dataclass(frozen=True)
class Adapter:
    """
    What gathers bytes at the host's end of the line, as USB adapters do.

    Attributes
    ----------
    packet
        Bytes that are handed on at once when so many have come.
    latency
        Seconds after its first byte at which a packet is handed on however few have come.

    """

    packet: int = 512
    latency: float = 0.001


class Arrival(NamedTuple):
    """Bytes that reach the host together."""

    due: float
    data: bytes
    rate: int


class _Packet(NamedTuple):
    """Bytes back to back, the first one's start bit at `begin`."""

    due: float
    begin: float
    data: bytes
    rate: int


class Line:
    """
    The sending direction of one serial line, in given times.

    Attributes
    ----------
    free_at
        When the last byte given to it so far has left.

    """

    def __init__(self, adapter: Adapter = Adapter(),
                 late: Callable[[float], float] = lambda due: due) -> None:
        """Take the adapter, and what delays it further: from a due time to a later one."""
        self._adapter, self._late = adapter, late
        self._packets: deque[_Packet] = deque()
        self._last_due = -math.inf
        self.free_at = -math.inf

    @property
    def next_due(self) -> float:
        """When something next reaches the host; infinity for never."""
        return self._packets[0].due if self._packets else math.inf

    def send(self, data: bytes, at: float, rate: int) -> float:
        """Send bytes from a time on, or from when the line is free; return when they have left."""
        byte = BITS / rate
        begin = max(at, self.free_at)
        size = min(self._adapter.packet, 1 + int(self._adapter.latency / byte))
        for k in range(0, len(data), size):
            part, start = data[k:k + size], begin + k * byte
            full = len(part) == self._adapter.packet
            gathered = len(part) * byte if full else byte + self._adapter.latency
            due = max(self._late(start + gathered), self._last_due)
            self._last_due = due
            self._packets.append(_Packet(due, start, part, rate))
        self.free_at = begin + len(data) * byte
        return self.free_at

    def cut(self, at: float) -> None:
        """Stop sending: the byte on the line at that time is the last one."""
        if at >= self.free_at:
            return
        kept = []
        for packet in self._packets:
            byte = BITS / packet.rate
            count = math.ceil((at - packet.begin) / byte)
            if count > 0:
                kept.append(packet._replace(data=packet.data[:count]))
                self.free_at = packet.begin + min(count, len(packet.data)) * byte
        if not kept:
            self.free_at = at
        self._packets = deque(kept)

    def clear(self) -> None:
        """Lose all that has not reached the host."""
        self._packets.clear()
        self.free_at = -math.inf

    def arrived(self, now: float) -> list[Arrival]:
        """Return, once, what reaches the host until now."""
        out = []
        while self._packets and self._packets[0].due <= now:
            packet = self._packets.popleft()
            out.append(Arrival(packet.due, packet.data, packet.rate))
        return out
