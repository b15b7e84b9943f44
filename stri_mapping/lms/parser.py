# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Telegrams out of a stream of bytes that may be damaged, cut or garbage."""

from __future__ import annotations

from dataclasses import dataclass
import re
from typing import NamedTuple

from stri_mapping.lms.answers import DECODERS
from stri_mapping.lms.requests import FIXED
from stri_mapping.lms.samples import COUNT_BITS, Scan
from stri_mapping.lms.telegram import ANSWER, HEADER, intact, MAX_PAYLOAD, OVERHEAD, STX, Telegram

# Answers that no dataclass stands for: fields, outputs, contours, and cartesian values (0xF6),
# whose form is not documented.
OTHER_ANSWERS = (0xC0, 0xC1, 0xC2, 0xC5, 0xC6, 0xCA, 0xE9, 0xF6, 0xFB, 0xFC)
ANSWER_CODES = frozenset((*DECODERS, *OTHER_ANSWERS))
REQUEST_CODES = frozenset((*FIXED, 0x20, 0x77, 0x3E, 0x3F,
                           *(code - 0x80 for code in OTHER_ANSWERS)))
# Payload bytes of the longest answer that is not made of measured values: 255 fault entries.
LONGEST_REPORT = 512
MEASURED = frozenset((0xB0, 0xB6, 0xB7, 0xBE, 0xBF, 0xC4, 0xF5, 0xF6))
INTERESTING = re.compile(b'[\x02\x06\x15]')


class Received(NamedTuple):
    """
    A telegram and when it began.

    Attributes
    ----------
    telegram
        Payload and address.
    begin_ns
        When its first bit can have come at the latest, on the clock that `feed` is given.

    """

    telegram: Telegram
    begin_ns: int


class Handshake(NamedTuple):
    """A bare `ACK` or `NAK` outside any telegram."""

    code: int


@dataclass
class LineCounts:
    """What was met on the line."""

    bytes: int = 0
    telegrams: int = 0
    crc_errors: int = 0
    noise_bytes: int = 0


class Parser:
    """
    Finds every intact telegram of a stream.

    After a telegram that is damaged, the search goes on with the byte after its STX and not
    after its purported end: where an answer cut a scan in two, only that scan is lost.

    Parameters
    ----------
    answers
        Whether to look for answers of scanners, or for requests of a host.
    counts
        What is met is counted there.

    """

    def __init__(self, answers: bool = True, counts: LineCounts | None = None) -> None:
        """Start with an empty buffer."""
        self.counts = LineCounts() if counts is None else counts
        # Nanoseconds that a byte takes on the line; 0 where unknown.
        self.byte_ns = 0
        self._answers = answers
        self._codes = ANSWER_CODES if answers else REQUEST_CODES
        self._buffer = bytearray()
        self._suspect = 0                       # end of a damaged telegram in the buffer
        self._reads: list[tuple[int, int]] = []     # where in the buffer each read ended, when

    @property
    def missing(self) -> int:
        """Bytes by which the telegram that has begun is still short; 0 between telegrams."""
        if len(self._buffer) <= HEADER or self._buffer[0] != STX:
            return 0
        return max(self._total(0) - len(self._buffer), 0)

    def clear(self) -> None:
        """Forget what has come of an unfinished telegram."""
        self._drop(len(self._buffer))

    def feed(self, data: bytes, now_ns: int) -> list[Received | Handshake]:
        """
        Take in what one read returned; return what has become complete, in its order.

        Parameters
        ----------
        data
            Bytes.
        now_ns
            When the read returned.

        """
        self.counts.bytes += len(data)
        self._buffer += data
        self._reads.append((len(self._buffer), now_ns))
        found: list[Received | Handshake] = []
        at = 0
        while (match := INTERESTING.search(self._buffer, at)) is not None:
            self.counts.noise_bytes += match.start() - at
            at = match.start()
            if self._buffer[at] == STX:
                end = self._telegram_end(at)
                if end is None:
                    break                       # not all of it is there yet
                if end:
                    found.append(self._take(at, end))
                else:
                    self.counts.noise_bytes += 1
                at = end or at + 1
                continue
            if at >= self._suspect:
                found.append(Handshake(self._buffer[at]))
            at += 1
        else:
            self.counts.noise_bytes += len(self._buffer) - at
            at = len(self._buffer)
        self._drop(at)
        return found

    def idle(self) -> list[Received | Handshake]:
        """
        Return telegrams that are intact inside an unfinished one.

        For when the line has fallen silent: what seemed to begin a telegram was not one, or one
        that an answer has cut, and the bytes that it lacks will never come.
        """
        for at in range(1, len(self._buffer)):
            if self._buffer[at] == STX:
                end = self._telegram_end(at)
                if end:
                    self.counts.crc_errors += 1
                    self.counts.noise_bytes += at
                    self._drop(at)
                    return self.feed(b'', self._reads[-1][1])
        return []

    def _take(self, at: int, end: int) -> Received:
        self.counts.telegrams += 1
        self._suspect = 0
        payload = bytes(self._buffer[at + HEADER:end - 2])
        read_end, now_ns = next(read for read in self._reads if read[0] > at)
        # the bytes behind it in the same read took their time too, as did its first byte
        return Received(Telegram(payload, self._buffer[at + 1]),
                        now_ns - (read_end - at) * self.byte_ns)

    def _telegram_end(self, at: int) -> int | None:
        """Return where a telegram ends, 0 if none begins there, None if that is still open."""
        if not self._plausible(at):
            return 0
        available = len(self._buffer) - at
        if available <= HEADER or available < self._total(at):
            return None
        end = at + self._total(at)
        if intact(bytes(self._buffer[at:end])):
            return end
        self.counts.crc_errors += 1
        self._suspect = max(self._suspect, end)
        return 0

    def _plausible(self, at: int) -> bool:
        """Return whether the bytes from an STX on, as far as they are there, begin a telegram."""
        header = self._buffer[at:at + HEADER + 3]
        if len(header) > 1 and (header[1] >= ANSWER) != self._answers:
            return False
        if len(header) < HEADER:
            return True
        length = self._total(at) - OVERHEAD
        if not 0 < length <= MAX_PAYLOAD:
            return False
        if len(header) > HEADER and header[HEADER] not in self._codes:
            return False
        if len(header) > HEADER and header[HEADER] not in MEASURED and length > LONGEST_REPORT:
            return False
        if len(header) < HEADER + 3 or header[HEADER] != Scan.code:
            return True
        count = int.from_bytes(header[HEADER + 1:], 'little') & COUNT_BITS
        return length - 2 * count in (4, 6)     # without or with real-time indices

    def _total(self, at: int) -> int:
        return OVERHEAD + int.from_bytes(self._buffer[at + 2:at + 4], 'little')

    def _drop(self, count: int) -> None:
        """Forget the beginning of the buffer."""
        del self._buffer[:count]
        self._suspect = max(self._suspect - count, 0)
        self._reads = [(end - count, now) for end, now in self._reads if end > count]
