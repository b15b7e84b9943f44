# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What a scanner answers, and any answer from its payload; measured values are in `samples`."""

from __future__ import annotations

from dataclasses import dataclass
import struct
from typing import ClassVar

from stri_mapping.errors import LmsError
from stri_mapping.lms.configuration import Configuration
from stri_mapping.lms.samples import (
    FieldValues,
    MeanScan,
    MeanSubRange,
    MeasuredAnswer,
    PairScan,
    RemissionScan,
    Scan,
    SubRange,
)
from stri_mapping.lms.status import Status

# Characters of a type string such as "LMS200;S18063;V02.19 ".
TYPE_SIZE = 21
SEVERITIES = ('none', 'info', 'warning', 'error', 'fatal')
GONE = 0x80
ERROR_TEXTS = {
    5: 'dazzle test', 6: 'comparators', 7: 'comparators', 17: 'window oil', 18: 'window dirt',
    19: 'window dirt', 20: 'window oil', 21: 'window reference', 22: 'window reference',
    27: 'output defective', 28: 'output defective', 29: 'motor speed', 45: 'one value missing',
    46: 'a scan missing or too long', 47: 'reference target', 49: 'laser power',
    56: 'watchdog', 57: 'no zero index', 58: 'synchronisation', 59: 'synchronisation',
    60: 'synchronisation', 61: 'synchronisation', **dict.fromkeys(range(86, 93),
                                                                  'reference target'),
    124: 'memory', 125: 'memory', 126: 'memory'}


@dataclass(frozen=True)
class ResetTaken:
    """0x91: the scanner is about to reset itself."""

    code: ClassVar[int] = 0x91

    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return bytes((self.code, self.status))

    @classmethod
    def decode(cls, payload: bytes) -> ResetTaken:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        return cls(*_unpack('<B', payload))


@dataclass(frozen=True)
class Refused:
    """0x92: a request that is not allowed now: wrong mode, or a parameter out of range."""

    code: ClassVar[int] = 0x92

    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return bytes((self.code, self.status))

    @classmethod
    def decode(cls, payload: bytes) -> Refused:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        return cls(*_unpack('<B', payload))


@dataclass(frozen=True)
class TypeAnswer:
    """
    0xBA: what scanner it is.

    Attributes
    ----------
    text
        Type, variant and firmware, such as "LMS200;S18063;V02.19 ".

    """

    code: ClassVar[int] = 0xBA

    text: str
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return bytes((self.code,)) + self.text.encode('latin-1') + bytes((self.status,))

    @classmethod
    def decode(cls, payload: bytes) -> TypeAnswer:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        if len(payload) < 2:
            raise LmsError('a type answer without its status')
        return cls(payload[1:-1].decode('latin-1'), payload[-1])


@dataclass(frozen=True)
class PowerOn(TypeAnswer):
    """0x90: the scanner is ready after power-on or reset; nobody asked."""

    code = 0x90


@dataclass(frozen=True)
class ModeAnswer:
    """0xA0: result of a mode or rate switch: 0 done, 1 refused.  It does not say of which."""

    code: ClassVar[int] = 0xA0

    result: int = 0
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return bytes((self.code, self.result, self.status))

    @classmethod
    def decode(cls, payload: bytes) -> ModeAnswer:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        return cls(*_unpack('<BB', payload))


@dataclass(frozen=True)
class ErrorList:
    """
    0xB2: the fault memory.

    Attributes
    ----------
    entries
        Pairs of type (index into `SEVERITIES`, plus `GONE` when no longer present) and number.

    """

    code: ClassVar[int] = 0xB2

    entries: tuple[tuple[int, int], ...] = ()
    status: int = 0x10

    @property
    def texts(self) -> list[str]:
        """The entries in words."""
        return [describe_error(kind, number) for kind, number in self.entries if kind & ~GONE]

    def encode(self) -> bytes:
        """Return the payload."""
        return bytes((self.code, *(b for pair in self.entries for b in pair), self.status))

    @classmethod
    def decode(cls, payload: bytes) -> ErrorList:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        data = payload[1:-1]
        if len(payload) < 2 or len(data) % 2:
            raise LmsError(f'an error list of {len(payload)} bytes: want pairs')
        return cls(tuple(zip(data[0::2], data[1::2])), payload[-1])


@dataclass(frozen=True)
class Hours:
    """0xB5: operating time in units of two hours, and number of starts."""

    code: ClassVar[int] = 0xB5

    double_hours: int
    starts: int
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return struct.pack('<BHHB', self.code, self.double_hours, self.starts, self.status)

    @classmethod
    def decode(cls, payload: bytes) -> Hours:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        return cls(*_unpack('<HHB', payload))


@dataclass(frozen=True)
class VariantAnswer:
    """0xBB: whether (1) or not (0) the variant was taken, and the one that is active."""

    code: ClassVar[int] = 0xBB

    accepted: int
    angle: int
    resolution: int
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return struct.pack('<BBHHB', self.code, self.accepted, self.angle, self.resolution,
                           self.status)

    @classmethod
    def decode(cls, payload: bytes) -> VariantAnswer:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        return cls(*_unpack('<BHHB', payload))


@dataclass(frozen=True)
class PowerOnSet:
    """0xE6: whether (1) or not (0) the behaviour at power-on was taken, and what it is."""

    code: ClassVar[int] = 0xE6

    accepted: int
    setting: int
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return bytes((self.code, self.accepted, self.setting, self.status))

    @classmethod
    def decode(cls, payload: bytes) -> PowerOnSet:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        return cls(*_unpack('<BBB', payload))


@dataclass(frozen=True)
class ConfigurationRead:
    """0xF4: the configuration, part 1."""

    code: ClassVar[int] = 0xF4

    configuration: Configuration
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return bytes((self.code,)) + self.configuration.block + bytes((self.status,))

    @classmethod
    def decode(cls, payload: bytes) -> ConfigurationRead:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        return cls(Configuration(payload[1:-1]), payload[-1])


@dataclass(frozen=True)
class ConfigurationWritten:
    """0xF7: whether (1) or not (0) a configuration was taken, and the one that is active."""

    code: ClassVar[int] = 0xF7

    accepted: int
    configuration: Configuration
    status: int = 0x10

    def encode(self) -> bytes:
        """Return the payload."""
        return (bytes((self.code, self.accepted)) + self.configuration.block
                + bytes((self.status,)))

    @classmethod
    def decode(cls, payload: bytes) -> ConfigurationWritten:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        if len(payload) < 3:
            raise LmsError('an answer to a configuration without its result')
        return cls(payload[1], Configuration(payload[2:-1]), payload[-1])


Answer = (ResetTaken | Refused | TypeAnswer | ModeAnswer | ErrorList | Hours | VariantAnswer
          | PowerOnSet | ConfigurationRead | ConfigurationWritten | Status | MeasuredAnswer)
DECODERS = {kind.code: kind.decode for kind in (
    ResetTaken, Refused, TypeAnswer, PowerOn, ModeAnswer, ErrorList, Hours, VariantAnswer,
    PowerOnSet, ConfigurationRead, ConfigurationWritten, Status, Scan, MeanScan, SubRange,
    FieldValues, MeanSubRange, RemissionScan, PairScan)}


def decode_answer(payload: bytes) -> Answer:
    """
    Return the answer that a payload is; the inverse of its `encode`.

    Raises
    ------
    LmsError
        If the code is unknown or the length does not fit it.

    """
    decoder = DECODERS.get(payload[0]) if payload else None
    if decoder is None:
        raise LmsError(f'answer {payload[:1].hex() or "(empty)"} is unknown')
    answer: Answer = decoder(payload)
    return answer


def describe_error(kind: int, number: int) -> str:
    """Return one entry of the fault memory in words."""
    severity = kind & ~GONE
    word = SEVERITIES[severity] if severity < len(SEVERITIES) else f'type {severity}'
    text = ERROR_TEXTS.get(number, 'not documented')
    return f'{word} {number} ({text})' + (', no longer present' if kind & GONE else '')


def _unpack(layout: str, payload: bytes) -> tuple[int, ...]:
    """Return the numbers after the code of a payload that must have exactly that layout."""
    try:
        return struct.unpack(layout, payload[1:])
    except struct.error:
        raise LmsError(f'answer {payload[:1].hex()} of {len(payload)} bytes: want '
                       f'{1 + struct.calcsize(layout)}') from None
