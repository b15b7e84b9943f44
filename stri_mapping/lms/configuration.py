# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Part 1 of a scanner's configuration (commands 0x74, 0x77): the bytes a driver must know."""

from __future__ import annotations

from dataclasses import dataclass

from stri_mapping.errors import LmsError

# Offsets in the block (TL, blocks A to A4; older firmware ends after 32 bytes).
SENSITIVITY, AVAILABILITY, MODE, UNIT = 3, 4, 5, 6
INDICES_BIT = 0x02
SIZES = (32, 34)


@dataclass(frozen=True)
class Configuration:
    """
    The configuration as the scanner gave it; everything a driver does not set is kept.

    Attributes
    ----------
    block
        32 (older firmware) or 34 bytes.

    Raises
    ------
    LmsError
        If the block has another length.

    """

    block: bytes

    def __post_init__(self) -> None:
        """Check the length."""
        if len(self.block) not in SIZES:
            raise LmsError(f'a configuration of {len(self.block)} bytes: want 32 or 34')

    @property
    def sensitivity(self) -> int:
        """0 standard, 1 medium, 2 low, 3 high; peak detection on an LMS200 or 220."""
        return self.block[SENSITIVITY]

    @property
    def indices(self) -> bool:
        """Whether real-time indices are appended to measured values."""
        return bool(self.block[AVAILABILITY] & INDICES_BIT)

    @property
    def measuring_mode(self) -> int:
        """What the bits of a sample word mean: see `measuring`."""
        return self.block[MODE]

    @property
    def unit(self) -> int:
        """0 centimetres, 1 millimetres."""
        return self.block[UNIT]

    def changed(
        self,
        *,
        sensitivity: int | None = None,
        indices: bool | None = None,
        measuring_mode: int | None = None,
        unit: int | None = None,
    ) -> Configuration:
        """Return the configuration with some settings changed, None keeping what is there."""
        block = bytearray(self.block)
        for offset, value in ((SENSITIVITY, sensitivity), (MODE, measuring_mode), (UNIT, unit)):
            if value is not None:
                block[offset] = value
        if indices is not None:
            block[AVAILABILITY] = block[AVAILABILITY] & ~INDICES_BIT | INDICES_BIT * indices
        return Configuration(bytes(block))


# Factory settings: unit mm, 8 m, no real-time indices (TL, the block defaults).
FACTORY = Configuration(bytes.fromhex(
    '0000 46 00 00 00 01 00 00 02 02 02 00 000A0A5064 000A0A5064 000A0A5064 00 00 0000 0200'))
