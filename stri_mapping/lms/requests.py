# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the host asks of a scanner: a command byte and its parameters, as dataclasses."""

from __future__ import annotations

from dataclasses import astuple, dataclass
import struct
from typing import ClassVar

from stri_mapping.errors import LmsError

PASSWORD = b'SICK_LMS'
# Sub-commands of 0x20.  What they stream is listed in `models`.
INSTALLATION, DIAGNOSIS, ALL_VALUES, ON_REQUEST = 0x00, 0x10, 0x24, 0x25
MEANS, SUB_RANGE, EVERY_TURN, PAIRS, REMISSION = 0x26, 0x27, 0x2A, 0x2B, 0x50
# Line rates in baud, and the sub-command that asks for each; the answer still comes at the old.
RATES = {9600: 0x42, 19200: 0x41, 38400: 0x40, 500000: 0x48}
# Bit 15 of a sub-range's first value: send each partial scan at once.
AT_ONCE = 0x8000


@dataclass(frozen=True)
class Request:
    """
    One request whose parameters are a fixed structure.

    Class attributes name the command byte and the `struct` format of the parameters, which are
    the fields in their order.
    """

    command: ClassVar[int]
    layout: ClassVar[str] = '<'

    def encode(self) -> bytes:
        """Return the payload; its first byte is the command."""
        return bytes((self.command,)) + struct.pack(self.layout, *astuple(self))


@dataclass(frozen=True)
class Reset(Request):
    """Reset the scanner: clears its fault memory, keeps its configuration."""

    command = 0x10


@dataclass(frozen=True)
class SwitchMode(Request):
    """
    Change operating mode or line rate, or test the password.

    Attributes
    ----------
    mode
        Sub-command, such as `ALL_VALUES` or one of `RATES`.
    parameters
        What the sub-command needs: `PASSWORD` for `INSTALLATION`, words for sub-ranges.

    """

    command = 0x20

    mode: int
    parameters: bytes = b''

    def encode(self) -> bytes:
        """Return the payload; its first byte is the command."""
        return bytes((self.command, self.mode)) + self.parameters


@dataclass(frozen=True)
class ReadScan(Request):
    """Ask for one scan: 1 all values, 6 every second, 7 every twentieth, 8 the present turn."""

    command, layout = 0x30, '<B'

    kind: int = 1


@dataclass(frozen=True)
class ReadStatus(Request):
    """Ask for the status."""

    command = 0x31


@dataclass(frozen=True)
class ReadErrors(Request):
    """Ask for the fault memory."""

    command = 0x32


@dataclass(frozen=True)
class ReadHours(Request):
    """Ask for operating time and number of starts (211, 221, 291)."""

    command = 0x35


@dataclass(frozen=True)
class ReadMean(Request):
    """Ask for the mean of 2 to 250 scans."""

    command, layout = 0x36, '<B'

    scans: int


@dataclass(frozen=True)
class ReadSubRange(Request):
    """Ask for the values first to last, counted from 1; `AT_ONCE` in first for partial scans."""

    command, layout = 0x37, '<HH'

    first: int
    last: int


@dataclass(frozen=True)
class ReadType(Request):
    """Ask for the type string."""

    command = 0x3A


@dataclass(frozen=True)
class SetVariant(Request):
    """Set the scanned angle (100 or 180 degrees) and the resolution (100, 50, 25 cdeg)."""

    command, layout = 0x3B, '<HH'

    angle: int
    resolution: int


@dataclass(frozen=True)
class ReadRemission(Request):
    """Ask an S14 for one scan with remission, values first to last counted from 1."""

    command, layout = 0x44, '<HH'

    first: int
    last: int


@dataclass(frozen=True)
class SetPowerOn(Request):
    """Set what survives a power cycle: 0 nothing, 1 the line rate, 2 the variant."""

    command, layout = 0x66, '<B'

    setting: int


@dataclass(frozen=True)
class ReadConfiguration(Request):
    """Ask for the configuration, part 1."""

    command = 0x74


@dataclass(frozen=True)
class WriteConfiguration(Request):
    """Write the configuration, part 1, as `Configuration.encode` gives it."""

    command = 0x77

    block: bytes

    def encode(self) -> bytes:
        """Return the payload; its first byte is the command."""
        return bytes((self.command,)) + self.block


FIXED: dict[int, type[Request]] = {kind.command: kind for kind in (
    Reset, ReadScan, ReadStatus, ReadErrors, ReadHours, ReadMean, ReadSubRange, ReadType,
    SetVariant, ReadRemission, SetPowerOn, ReadConfiguration)}


def decode_request(payload: bytes) -> Request:
    """
    Return the request that a payload is; the inverse of its `encode`.

    Raises
    ------
    LmsError
        If the command is unknown or its parameters have the wrong length.

    """
    if not payload:
        raise LmsError('an empty request')
    command, data = payload[0], payload[1:]
    if command == SwitchMode.command and data:
        return SwitchMode(data[0], data[1:])
    if command == WriteConfiguration.command and data:
        return WriteConfiguration(data)
    kind = FIXED.get(command)
    if kind is None:
        raise LmsError(f'request 0x{command:02X} is unknown')
    try:
        return kind(*struct.unpack(kind.layout, data))
    except struct.error:
        raise LmsError(f'request 0x{command:02X} with {len(data)} bytes of parameters: want '
                       f'{struct.calcsize(kind.layout)}') from None


def words(*values: int) -> bytes:
    """Return values as little-endian words, as the parameters of many sub-commands are."""
    return struct.pack(f'<{len(values)}H', *values)
