# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the mirror's turns measure, and the samples that a scanner makes of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from stri_mapping.lms.configuration import Configuration
from stri_mapping.lms.measuring import MODES, UNITS
from stri_mapping.scan import MIRROR_TURN

Array = NDArray[np.float64]
# Turns of the raster's full cycle when the step is 0.25 degrees: rasters are counted in these.
QUARTERS = 4
# What a white surface gives in the device's units: a byte of 0xC4, a word of 0xF5.
WHITE_BYTE, WHITE_WORD = 255.0, 13000.0
# Below 2^bits of the measuring mode: the code for a dazzled receiver.
DAZZLED = 2


class Turn(NamedTuple):
    """
    What one turn of the mirror measured.

    Attributes
    ----------
    ranges
        (n,) metres; +inf for no echo, NaN where dazzled.
    remission
        (n,) per cent of a white surface met head-on, or None.

    """

    ranges: Array
    remission: Array | None = None


class TurnSource(Protocol):
    """Where scans come from."""

    def turn(self, number: int, bearings: Array) -> Turn | None:
        """
        Return what a turn measured, or None if that cannot be told (yet).

        Parameters
        ----------
        number
            Of the turn, counted from the mirror's first one.
        bearings
            (n,) degrees in the laser's frame, 0 straight ahead, increasing; read-only.

        """


@dataclass(frozen=True)
class Mirror:
    """
    The turning mirror, every scanner's only clock.

    The ray at bearing -90 + a degrees of turn q is sent at ``start + period (q + a / 360)``.

    Attributes
    ----------
    start
        When turn 0 began, seconds.
    period
        Seconds a turn really takes.

    """

    start: float = 0.0
    period: float = MIRROR_TURN

    def begin(self, number: int) -> float:
        """Return when a turn begins, which is when the one before it ends."""
        return self.start + self.period * number

    def next_turn(self, at: float) -> int:
        """Return the number of the first turn that begins at or after a time."""
        return max(0, int(np.ceil((at - self.start) / self.period - 1e-9)))


class Variant(NamedTuple):
    """Scanned angle in degrees (180, 100; 90 for the S14), and resolution in 1/100 degrees."""

    angle: int = 180
    resolution: int = 50

    @property
    def turns(self) -> int:
        """Turns that make a whole scan; the S14 needs one."""
        return 1 if self.angle == 90 else 100 // self.resolution

    def raster(self, number: int) -> int:
        """Return the raster of a turn, in quarters of a degree."""
        return number % self.turns * (QUARTERS // self.turns)

    def bearings(self, number: int, wide: bool = False) -> Array:
        """Return the bearings (n,) of a turn; `wide` for 180 degrees whatever is set (0x2A)."""
        if self.angle == 90:
            return _bearings(90, 0, self.resolution)
        return _bearings(180 if wide else self.angle, self.raster(number), 100)


@cache
def _bearings(angle: int, raster: int, step: int) -> Array:
    first = -0.5 * angle + raster / QUARTERS
    bearings = np.arange(first, 0.5 * angle + 1e-9, step / 100.0)
    bearings.flags.writeable = False
    return bearings


def whole(source: TurnSource, variant: Variant, last: int) -> Turn | None:
    """Return the whole scan whose last turn has a number, its rasters interlaced."""
    parts: list[Turn] = []
    for number in range(last - variant.turns + 1, last + 1):
        part = source.turn(number, variant.bearings(number))
        if part is None:
            return None
        parts.append(part)
    if len(parts) == 1:
        return parts[0]
    ranges = _interlaced([part.ranges for part in parts])
    remission = [part.remission for part in parts if part.remission is not None]
    return Turn(ranges, _interlaced(remission) if len(remission) == len(parts) else None)


def _interlaced(parts: list[Array]) -> Array:
    out = np.empty(sum(len(part) for part in parts))
    for k, part in enumerate(parts):
        out[k::len(parts)] = part
    return out


def words(ranges: Array, configuration: Configuration) -> NDArray[np.uint16]:
    """
    Return the sample words (n,) of ranges (n,) in metres, by measuring mode and unit.

    Where nothing comes back they say "beyond maximum", as scanners outdoors do.
    """
    mode = MODES[configuration.measuring_mode]
    steps = np.rint(ranges * (1.0 / UNITS[configuration.unit]))
    out = np.maximum(np.minimum(steps, mode.limit), 0.0)
    out[np.isnan(out)] = (1 << mode.bits) - DAZZLED
    return out.astype('<u2')


def remission_units(remission: Array | None, count: int, white: float) -> Array:
    """Return remission (n,) in a device's units; zeros where the source tells none."""
    if remission is None:
        return np.zeros(count)
    return np.clip(np.rint(0.01 * white * remission), 0.0, white)
