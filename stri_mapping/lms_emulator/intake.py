# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The scanner's ear: telegrams of the host from bytes and the times at which they come."""

from __future__ import annotations

from typing import NamedTuple

from stri_mapping.errors import LmsError
from stri_mapping.lms.telegram import OVERHEAD, STX, Telegram, unframe
from stri_mapping.lms_emulator.line import BITS

# The largest request is 0x77 with 34 bytes; a greater length is not a telegram's.
MAX_REQUEST = 64
# A pause between two bytes of a telegram that makes the scanner drop it, seconds (TL 4.3).
GAP = 0.006


class Heard(NamedTuple):
    """A telegram of the host, None where its CRC is wrong, and when its last byte was there."""

    at: float
    telegram: Telegram | None


class Intake:
    """Finds telegrams; bytes that begin none, and telegrams with a pause inside, are dropped."""

    def __init__(self, gap: float = GAP) -> None:
        """Take the longest pause within a telegram, seconds."""
        self._gap = gap
        self._buffer = bytearray()
        self._end = 0.0                 # when the last byte was there

    def clear(self) -> None:
        """Forget what was heard of an unfinished telegram."""
        self._buffer.clear()

    def feed(self, data: bytes, at: float, rate: int) -> list[Heard]:
        """Return the telegrams that are complete with bytes which come in from a time on."""
        begin = max(at, self._end)
        if self._buffer and begin - self._end > self._gap:
            self._buffer.clear()
        self._end = begin + len(data) * BITS / rate
        self._buffer += data
        heard = []
        while (size := self._size()) is not None and len(self._buffer) >= size:
            whole = bytes(self._buffer[:size])
            del self._buffer[:size]
            end = self._end - len(self._buffer) * BITS / rate
            try:
                heard.append(Heard(end, unframe(whole)))
            except LmsError:
                heard.append(Heard(end, None))
        return heard

    def _size(self) -> int | None:
        """Return the size of the telegram at the buffer's front, once that is known."""
        while True:
            start = self._buffer.find(STX)
            del self._buffer[:start if start >= 0 else len(self._buffer)]
            if len(self._buffer) < 4:
                return None
            length = int.from_bytes(self._buffer[2:4], 'little')
            if self._buffer[1] < 0x80 and 0 < length <= MAX_REQUEST:
                return length + OVERHEAD
            del self._buffer[0]
