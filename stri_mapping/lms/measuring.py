# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the bits of a sample word mean: distance, flags and codes by the measuring mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stri_mapping.errors import LmsError
from stri_mapping.lms.samples import CENTIMETRES, MILLIMETRES, Words

Array = NDArray[np.float64]
UNITS = {CENTIMETRES: 0.01, MILLIMETRES: 0.001}
# Distances from 2^B - 9 up are no distances, the three without a name included.  By REP-117
# "beyond maximum" is +inf: nothing in range.  The others, "no echo" among them, are NaN: black
# or mirroring things give none either, so that nothing is known of what is there (the
# precedent is the sicktoolbox node of ROS 1).
CODES = {1: 'no echo', 2: 'dazzled', 3: 'arithmetic overflow', 5: 'signal too weak',
         6: 'read error', 9: 'beyond maximum'}
BEYOND = 9


@dataclass(frozen=True)
class MeasuringMode:
    """
    One measuring mode (block D of the configuration).

    Attributes
    ----------
    number
        As in the configuration.
    bits
        Number B of distance bits; the codes count down from 2^B - 1.
    flags
        By name the bits above: lowest bit and number of bits.
    full_word
        Whether a distance fills the whole word though its codes are those of `bits`.

    """

    number: int
    bits: int
    flags: tuple[tuple[str, int, int], ...] = ()
    full_word: bool = False

    @property
    def limit(self) -> int:
        """The lowest code: distances are smaller."""
        return (1 << self.bits) - BEYOND

    def range_max(self, unit: int) -> float:
        """Return the largest range in metres that can be sent."""
        return self.limit * UNITS[unit]

    def ranges(self, words: Words, unit: int) -> Array:
        """
        Return the ranges (n,) in metres of sample words (n,).

        By REP-117 +inf is nothing in range, NaN no reading.

        Raises
        ------
        LmsError
            If the unit is a reserved one.

        """
        if unit not in UNITS:
            raise LmsError(f'unit {unit} of a scan is reserved: want 0 (cm) or 1 (mm)')
        value = words if self.full_word else words & np.uint16((1 << self.bits) - 1)
        metres: Array = np.asarray(value * UNITS[unit], dtype=float)
        codes = value >= self.limit
        if codes.any():
            metres[codes] = np.where(value[codes] == self.limit, np.inf, np.nan)
        return metres

    def flag(self, name: str, words: Words) -> Words:
        """Return one flag (n,) of sample words (n,)."""
        for each, low, width in self.flags:
            if each == name:
                return words >> np.uint16(low) & np.uint16((1 << width) - 1)
        raise LmsError(f'measuring mode 0x{self.number:02X} has no flag "{name}"')

    def reflector_levels(self, words: Words) -> Words | None:
        """Return the reflector level (n,) of sample words, None in a mode without."""
        names = [name for name, _, _ in self.flags]
        return self.flag('reflector', words) if 'reflector' in names else None


MODES = {mode.number: mode for mode in (
    MeasuringMode(0x00, 13, (('field_a', 13, 1), ('field_b', 14, 1), ('dazzle', 15, 1))),
    MeasuringMode(0x01, 13, (('reflector', 13, 3),)),
    MeasuringMode(0x02, 13, (('field_a', 13, 1), ('field_b', 14, 1), ('field_c', 15, 1))),
    MeasuringMode(0x03, 14, (('reflector', 14, 2),)),
    MeasuringMode(0x04, 14, (('field_a', 14, 1), ('field_b', 15, 1))),
    MeasuringMode(0x05, 15, (('reflector', 15, 1),)),
    MeasuringMode(0x06, 15, (('field_a', 15, 1),)),
    MeasuringMode(0x0D, 13),        # reserved in TL; other drivers read remission pairs with these
    MeasuringMode(0x0E, 13),
    MeasuringMode(0x0F, 15, full_word=True))}
# Energy instead of distance: nothing a scan could be made of.
ENERGY = 0x3F


def measuring_mode(number: int) -> MeasuringMode:
    """
    Return a measuring mode.

    Raises
    ------
    LmsError
        If it measures no distances or is unknown, naming those that do.

    """
    mode = MODES.get(number)
    if mode is None:
        what = 'gives energy, not distance' if number == ENERGY else 'is unknown'
        raise LmsError(f'measuring mode 0x{number:02X} {what}; known are '
                       f'{", ".join(map(str, MODES))}')
    return mode
