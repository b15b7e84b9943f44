# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What a serial receiver makes of bytes that were sent at another rate than its own."""

from __future__ import annotations


def resampled(data: bytes, sent: int, received: int) -> bytes:
    """
    Return what a receiver at one rate reads of bytes sent back to back at another.

    Both sides use 8 data bits, no parity and one stop bit.  The receiver takes a falling edge
    for a start bit and samples the line in the middle of the eight bits that follow; a missing
    stop bit is not looked at, as by a Linux tty that ignores framing errors.

    Parameters
    ----------
    data
        As sent.
    sent, received
        Rates of sender and receiver, baud; a receiver at 0 reads nothing.

    """
    if sent == received or received == 0:
        return data if received else b''
    levels = _levels(data)
    step = sent / received          # the sender's bits in one of the receiver's
    out = bytearray()
    edge = _falling_edge(levels, 0.0)
    while edge is not None:
        samples = [_level(levels, edge + (k + 1.5) * step) for k in range(8)]
        out.append(sum(bit << k for k, bit in enumerate(samples)))
        edge = _falling_edge(levels, edge + 9.5 * step)
    return bytes(out)


def _levels(data: bytes) -> list[int]:
    """Return the line's level for every bit time: start bit 0, data from the low bit, stop 1."""
    return [level for byte in data
            for level in (0, *((byte >> k) & 1 for k in range(8)), 1)]


def _level(levels: list[int], at: float) -> int:
    """Return the level at a time in bits; the idle line is high."""
    return levels[int(at)] if at < len(levels) else 1


def _falling_edge(levels: list[int], after: float) -> int | None:
    """Return the bit time at which the line next falls, at or after a time in bits."""
    for k in range(max(int(after), 0), len(levels)):
        if levels[k] == 0 and (k == 0 or levels[k - 1] == 1) and k >= after:
            return k
    return None
