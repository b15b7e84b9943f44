# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Answers that carry measured values: raw sample words with what is needed to read them."""

from __future__ import annotations

from dataclasses import dataclass
import struct
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stri_mapping.errors import LmsError

Words = NDArray[np.uint16]
# The count word: number of values, raster of a partial scan, whether it is one, unit.
COUNT_BITS, RASTER_SHIFT, PARTIAL_BIT, UNIT_SHIFT = 0x03FF, 11, 0x2000, 14
CENTIMETRES, MILLIMETRES = 0, 1


class Indices(NamedTuple):
    """
    Real-time indices, where availability bit 1 of the configuration is set; both modulo 256.

    Attributes
    ----------
    turn
        Counts turns of the mirror.
    telegram
        Counts telegrams sent.

    """

    turn: int
    telegram: int


@dataclass(frozen=True)
class Samples:
    """
    Sample words and the count word before them.

    Attributes
    ----------
    data
        Little-endian words: distance bits and flag bits by the measuring mode.
    unit
        0 centimetres, 1 millimetres; the scanner states it with every scan.
    raster
        None for a whole scan, else which of the up to four turns of the mirror this is, its
        first value being at raster * 0.25 degrees.

    """

    data: bytes
    unit: int = MILLIMETRES
    raster: int | None = None

    def __len__(self) -> int:
        """Return the number of values."""
        return len(self.data) // 2

    @property
    def words(self) -> Words:
        """The words (n,), read-only."""
        return np.frombuffer(self.data, '<u2')

    def encode(self) -> bytes:
        """Return count word and samples."""
        partial = 0 if self.raster is None else PARTIAL_BIT | self.raster << RASTER_SHIFT
        return struct.pack('<H', len(self) | partial | self.unit << UNIT_SHIFT) + self.data

    @staticmethod
    def decode(data: bytes, word_size: int = 2) -> tuple[Samples, bytes]:
        """Return the samples at the beginning of some bytes, and the bytes after them."""
        count_word = _word(data, 0)
        end = 2 + word_size * (count_word & COUNT_BITS)
        if len(data) < end:
            raise LmsError(f'{count_word & COUNT_BITS} values in {len(data) - 2} bytes')
        raster = count_word >> RASTER_SHIFT & 3 if count_word & PARTIAL_BIT else None
        return Samples(data[2:end], count_word >> UNIT_SHIFT, raster), data[end:]


@dataclass(frozen=True)
class Scan:
    """0xB0: one whole scan, or what one turn of the mirror measured."""

    code: ClassVar[int] = 0xB0

    samples: Samples
    indices: Indices | None = None
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return b'\xB0' + self.samples.encode() + _tail(self.indices, self.status)

    @classmethod
    def decode(cls, payload: bytes) -> Scan:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        samples, rest = Samples.decode(payload[1:])
        return cls(samples, *_read_tail(rest))


@dataclass(frozen=True)
class MeanScan:
    """0xB6: the mean of some scans."""

    code: ClassVar[int] = 0xB6

    scans: int
    samples: Samples
    indices: Indices | None = None
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return (bytes((self.code, self.scans)) + self.samples.encode()
                + _tail(self.indices, self.status))

    @classmethod
    def decode(cls, payload: bytes) -> MeanScan:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        samples, rest = Samples.decode(payload[2:])
        return cls(_byte(payload, 1), samples, *_read_tail(rest))


@dataclass(frozen=True)
class SubRange:
    """0xB7: the values `first` to `last` of a scan, counted from 1."""

    code: ClassVar[int] = 0xB7

    first: int
    last: int
    samples: Samples
    indices: Indices | None = None
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return (struct.pack('<BHH', self.code, self.first, self.last) + self.samples.encode()
                + _tail(self.indices, self.status))

    @classmethod
    def decode(cls, payload: bytes) -> SubRange:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        samples, rest = Samples.decode(payload[5:])
        return cls(_word(payload, 1), _word(payload, 3), samples, *_read_tail(rest))


@dataclass(frozen=True)
class FieldValues:
    """
    0xBE: the values `first` to `last` of a scan, at most 100, each with the fields it is held to.

    Attributes
    ----------
    samples
        Four words a value: the sample, and what fields A, B and C reach there.

    """

    code: ClassVar[int] = 0xBE

    first: int
    last: int
    samples: Samples
    indices: Indices | None = None
    status: int = 0x10

    @property
    def table(self) -> Words:
        """Sample word and fields A, B, C (n, 4)."""
        return self.samples.words.reshape(-1, 4)

    def encode(self) -> bytes:
        """Return the payload."""
        count = len(self.samples) // 4 | self.samples.unit << UNIT_SHIFT
        return (struct.pack('<BHHH', self.code, self.first, self.last, count)
                + self.samples.data + _tail(self.indices, self.status))

    @classmethod
    def decode(cls, payload: bytes) -> FieldValues:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        samples, rest = Samples.decode(payload[5:], word_size=8)
        return cls(_word(payload, 1), _word(payload, 3), samples, *_read_tail(rest))


@dataclass(frozen=True)
class MeanSubRange:
    """0xBF: the mean of the values `first` to `last` over some scans."""

    code: ClassVar[int] = 0xBF

    scans: int
    first: int
    last: int
    samples: Samples
    indices: Indices | None = None
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return (struct.pack('<BBHH', self.code, self.scans, self.first, self.last)
                + self.samples.encode() + _tail(self.indices, self.status))

    @classmethod
    def decode(cls, payload: bytes) -> MeanSubRange:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        samples, rest = Samples.decode(payload[6:])
        return cls(_byte(payload, 1), _word(payload, 2), _word(payload, 4), samples,
                   *_read_tail(rest))


@dataclass(frozen=True)
class RemissionScan:
    """
    0xC4, S14 only: distances of a whole scan and the remission of some of them.

    Attributes
    ----------
    samples
        Distances.
    first, last
        Which values the remissions belong to, counted from 1.
    remission
        One byte a value, in the device's units.

    """

    code: ClassVar[int] = 0xC4

    samples: Samples
    first: int
    last: int
    remission: bytes
    indices: Indices | None = None
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return (b'\xC4' + self.samples.encode()
                + struct.pack('<HHH', len(self.remission), self.first, self.last)
                + self.remission + _tail(self.indices, self.status))

    @classmethod
    def decode(cls, payload: bytes) -> RemissionScan:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        samples, rest = Samples.decode(payload[1:])
        count = _word(rest, 0) & COUNT_BITS
        if len(rest) < 6 + count:
            raise LmsError(f'{count} remissions in {max(len(rest) - 6, 0)} bytes')
        return cls(samples, _word(rest, 2), _word(rest, 4), rest[6:6 + count],
                   *_read_tail(rest[6 + count:]))


@dataclass(frozen=True)
class PairRange:
    """Some neighbouring values of a `PairScan`, each a distance word and a remission word."""

    first: int
    last: int
    samples: Samples

    @property
    def distances(self) -> Words:
        """Distance words (n,)."""
        return self.samples.words[0::2]

    @property
    def remissions(self) -> Words:
        """Remission words (n,), 0 to about 13000 in the device's units."""
        return self.samples.words[1::2]


@dataclass(frozen=True)
class PairScan:
    """0xF5: distance and remission of the values of up to five ranges."""

    code: ClassVar[int] = 0xF5

    ranges: tuple[PairRange, ...]
    indices: Indices | None = None
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        parts = [struct.pack('<BH', self.code, len(self.ranges))]
        for each in self.ranges:
            count = len(each.samples) // 2 | each.samples.unit << UNIT_SHIFT
            parts.append(struct.pack('<HHH', each.first, each.last, count) + each.samples.data)
        return b''.join(parts) + _tail(self.indices, self.status)

    @classmethod
    def decode(cls, payload: bytes) -> PairScan:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        ranges, rest = [], payload[3:]
        for _ in range(_word(payload, 1)):
            first, last = _word(rest, 0), _word(rest, 2)
            samples, rest = Samples.decode(rest[4:], word_size=4)
            ranges.append(PairRange(first, last, samples))
        return cls(tuple(ranges), *_read_tail(rest))


MeasuredAnswer = (Scan | MeanScan | SubRange | FieldValues | MeanSubRange | RemissionScan
                  | PairScan)


def _tail(indices: Indices | None, status: int) -> bytes:
    return bytes((*(indices or ()), status))


def _read_tail(data: bytes) -> tuple[Indices | None, int]:
    """Return indices, if there are any, and status: the length tells which came."""
    if len(data) == 3:
        return Indices(data[0], data[1]), data[2]
    if len(data) == 1:
        return None, data[0]
    raise LmsError(f'{len(data)} bytes after the values: want 1 or 3')


def _word(data: bytes, offset: int) -> int:
    if len(data) < offset + 2:
        raise LmsError(f'an answer cut short: {len(data)} bytes')
    return int.from_bytes(data[offset:offset + 2], 'little')


def _byte(data: bytes, offset: int) -> int:
    if len(data) <= offset:
        raise LmsError(f'an answer cut short: {len(data)} bytes')
    return data[offset]
