# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The status answer 0xB1: a fixed structure, most of which only the maker can read."""

from __future__ import annotations

from dataclasses import dataclass, Field, field, fields
import struct
from typing import Any, ClassVar

from stri_mapping.errors import LmsError

# Payload bytes between the answer code and the status byte.  TL's own table sums to 146; its
# example and real scanners have 152: the field it calls a reserved word is the serial number.
SIZE = 152
# Line rates as the status names them.
RATE_WORDS = {0x8067: 9600, 0x8033: 19200, 0x8019: 38400, 0x8001: 500000}
# Microseconds of 1/90 of a mirror turn.
MOTOR_PARTS = 90
# The status byte that ends every answer: bits 0 to 2, and two more bits.
SEVERITIES = ('no error', 'info', 'warning', 'error', 'fatal error')
IMPLAUSIBLE, POLLUTED = 0x40, 0x80


def at(offset: int, layout: str, default: Any) -> Any:
    """Return a dataclass field that is stored at an offset of the payload."""
    return field(default=default, metadata={'offset': offset, 'layout': '<' + layout})


@dataclass(frozen=True)
class Status:
    """
    0xB1: what the scanner says of itself.

    Attributes
    ----------
    firmware, serial_number, boot_prom
        As they came, padded with blanks.
    mode
        Operating mode: a sub-command of 0x20.
    defect
        0 for none; 1 is also seen with nothing but an information entry pending.
    pollution, pollution_calibration
        Eight channels of the front window, and what they were when it was clean.
    reference, reference_calibration
        Four reference channels, likewise.
    motor
        Microseconds of 1/90 of a mirror turn.
    laser_power
        Percent of its calibration.
    measuring_mode, angle, resolution, rate_word, multiple_evaluation, keeps_rate, address,
    field_set, unit, laser
        Present settings: degrees, 1/100 degrees, a key of `RATE_WORDS`, and the rest as they are.
    raw
        All 152 bytes as they came; what is no field is kept by `encode`.
    status
        The status byte.

    """

    code: ClassVar[int] = 0xB1

    firmware: str = at(1, '7s', '')
    mode: int = at(8, 'B', 0x25)
    defect: int = at(9, 'B', 0)
    serial_number: str = at(10, '8s', '')
    special: int = at(18, 'B', 0)
    pollution: tuple[int, ...] = at(19, '8H', (0,) * 8)
    reference: tuple[int, ...] = at(35, '4H', (0,) * 4)
    pollution_calibration: tuple[int, ...] = at(43, '8H', (0,) * 8)
    reference_calibration: tuple[int, ...] = at(59, '4H', (0,) * 4)
    motor: int = at(67, 'H', 148)
    laser_power: int = at(83, 'H', 100)
    measuring_mode: int = at(102, 'B', 0)
    angle: int = at(107, 'H', 180)
    resolution: int = at(109, 'H', 50)
    rate_word: int = at(116, 'H', 0x8067)
    multiple_evaluation: int = at(118, 'B', 2)
    keeps_rate: int = at(119, 'B', 0)
    address: int = at(120, 'B', 0)
    field_set: int = at(121, 'B', 1)
    unit: int = at(122, 'B', 1)
    laser: int = at(123, 'B', 1)
    boot_prom: str = at(124, '7s', '')
    raw: bytes = bytes(SIZE)
    status: int = 0x10

    @property
    def rate(self) -> int | None:
        """Line rate in baud; None for a word that is not known."""
        return RATE_WORDS.get(self.rate_word)

    @property
    def window_pollution(self) -> float:
        """Largest share of a window channel's light that dirt takes, 0 to 1."""
        pairs = zip(self.pollution, self.pollution_calibration)
        return max((1.0 - now / clean for now, clean in pairs if clean and now), default=0.0)

    @property
    def turn_ms(self) -> float:
        """Milliseconds of a mirror turn, to 0.09: a check, not a clock."""
        return 1e-3 * MOTOR_PARTS * self.motor

    def encode(self) -> bytes:
        """Return the payload."""
        payload = bytearray(b'\xB1' + self.raw)
        for each in _stored():
            value, layout = getattr(self, each.name), each.metadata['layout']
            if isinstance(value, str):
                size = struct.calcsize(layout)
                value = value.encode('latin-1', 'replace').ljust(size)[:size]
            parts = value if isinstance(value, tuple) else (value,)
            struct.pack_into(layout, payload, each.metadata['offset'], *parts)
        return bytes(payload) + bytes((self.status,))

    @classmethod
    def decode(cls, payload: bytes) -> Status:
        """Return the answer of a payload; raises LmsError if its length does not fit."""
        if len(payload) != SIZE + 2:
            raise LmsError(f'a status of {len(payload)} bytes: want {SIZE + 2}')
        values: dict[str, Any] = {}
        for each in _stored():
            parts = struct.unpack_from(each.metadata['layout'], payload, each.metadata['offset'])
            value = parts if len(parts) > 1 else parts[0]
            values[each.name] = value.decode('latin-1') if isinstance(value, bytes) else value
        return cls(**values, raw=payload[1:-1], status=payload[-1])


def describe_status(status: int) -> str:
    """Return in words what the status byte of any answer says."""
    parts = [SEVERITIES[min(status & 7, len(SEVERITIES) - 1)]]
    parts += ['implausible values'] * bool(status & IMPLAUSIBLE)
    parts += ['front window polluted'] * bool(status & POLLUTED)
    return ', '.join(parts)


def _stored() -> list[Field[Any]]:
    return [each for each in fields(Status) if each.metadata]
