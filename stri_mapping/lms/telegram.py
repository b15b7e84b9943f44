# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The frame of every telegram: STX, address, length, payload, CRC; everything little endian.

The payload begins with the command or answer code.  There is no end mark and no byte stuffing:
STX, ACK and NAK occur freely inside payloads.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stri_mapping.errors import LmsError

STX, ACK, NAK = 0x02, 0x06, 0x15
# Host to scanner 0 means any scanner; an answer's address is the scanner's plus 0x80.
ANY_SCANNER, ANSWER = 0x00, 0x80
# Bytes before the payload, and bytes beside it.
HEADER, OVERHEAD = 4, 6
# The largest telegram that a scanner sends: 401 pairs of distance and remission (0xF5).
MAX_PAYLOAD = 1640
POLYNOMIAL = 0x8005


class Telegram(NamedTuple):
    """
    One intact telegram.

    Attributes
    ----------
    payload
        From the command or answer code to the last byte before the CRC.
    address
        As on the line: of an answer 0x80 and more.

    """

    payload: bytes
    address: int = ANSWER


def frame(payload: bytes, address: int = ANY_SCANNER) -> bytes:
    """
    Return a whole telegram.

    Raises
    ------
    LmsError
        If the payload is empty or longer than any telegram.

    """
    if not 0 < len(payload) <= MAX_PAYLOAD:
        raise LmsError(f'a payload of {len(payload)} bytes: want 1 to {MAX_PAYLOAD}')
    body = bytes((STX, address)) + len(payload).to_bytes(2, 'little') + payload
    return body + crc(body).to_bytes(2, 'little')


def unframe(data: bytes) -> Telegram:
    """
    Return what one whole telegram holds.

    Raises
    ------
    LmsError
        If the bytes are not exactly one intact telegram.

    """
    if len(data) <= OVERHEAD or data[0] != STX:
        raise LmsError(f'{len(data)} bytes that do not begin a telegram: {data[:8].hex(" ")}')
    length = int.from_bytes(data[2:4], 'little')
    if length + OVERHEAD != len(data):
        raise LmsError(f'a telegram of {len(data)} bytes whose header says {length + OVERHEAD}')
    if not intact(data):
        raise LmsError(f'CRC is {data[-2:].hex(" ")}, computed '
                       f'{crc(data[:-2]).to_bytes(2, "little").hex(" ")}')
    return Telegram(bytes(data[HEADER:-2]), data[1])


def intact(data: bytes) -> bool:
    """Return whether the last two bytes are the CRC of those before them."""
    return crc(data[:-2]) == int.from_bytes(data[-2:], 'little')


def crc(data: bytes) -> int:
    """
    Return the 16-bit check sum of an LMS 2xx (TL 3; polynomial 0x8005, start value 0).

    Its register moves by ONE bit a byte and takes in the byte together with the one before it.
    That is linear over GF(2): with byte i as the polynomial b_i(x) and n bytes,

        crc = b_(n-1) + (1 + x^7) * sum_(i < n-1) b_i x^(n-1-i)    mod x^16 + x^15 + x^2 + 1,

    so that each byte contributes by its value and its distance from the end alone.
    """
    values = np.frombuffer(data, np.uint8)
    if len(values) > HEADER + MAX_PAYLOAD:
        raise LmsError(f'CRC of {len(values)} bytes: no telegram is that long')
    rows = _ROWS[len(_ROWS) - len(values):]
    return int(np.bitwise_xor.reduce(_contributions().take(rows + values), initial=0))


# Where in the flat table the row of each byte begins, the last byte's row being the first.
_ROWS = 256 * np.arange(HEADER + MAX_PAYLOAD)[::-1].copy()


@cache
def _contributions() -> NDArray[np.uint16]:
    """Return what a byte (last index) so far from the end (first index) adds, flattened."""
    powers = [1]                        # x^k mod the polynomial
    for _ in range(HEADER + MAX_PAYLOAD + 16):
        powers.append((powers[-1] << 1) & 0xFFFF ^ (POLYNOMIAL if powers[-1] & 0x8000 else 0))
    x = np.array(powers, np.uint16)
    table = np.zeros((HEADER + MAX_PAYLOAD, 256), np.uint16)
    for bit in range(8):
        weight = x[bit:bit + len(table)] ^ x[bit + 7:bit + 7 + len(table)]
        weight[0] = x[bit]
        table[:, (np.arange(256) >> bit) & 1 == 1] ^= weight[:, None]
    return table.ravel()
