# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What a scanner streams: how it is asked for, what the line can carry, and where each ray is."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stri_mapping.errors import LmsSettingError
from stri_mapping.lms.clock import TURN_NS
from stri_mapping.lms.measuring import MeasuringMode
from stri_mapping.lms.models import Model, Variant
from stri_mapping.lms.requests import (
    ALL_VALUES,
    AT_ONCE,
    EVERY_TURN,
    PAIRS,
    RATES,
    REMISSION,
    SUB_RANGE,
    SwitchMode,
    words,
)
from stri_mapping.lms.samples import Indices, PairScan, RemissionScan, Samples, Scan, SubRange

Array = NDArray[np.float64]
Kind = Literal['turns', 'scans', 'remission']
KINDS: tuple[Kind, ...] = ('turns', 'scans', 'remission')
BITS_PER_BYTE = 10


@dataclass(frozen=True, eq=False)
class MeasuredScan:
    """
    One published scan, without its time.

    Attributes
    ----------
    ranges
        (n,) metres, REP-117.
    intensities
        (n,) in the device's units, None in modes without.
    first, step
        Degrees of the first ray and between rays, 0 to the right and 90 straight ahead.
    turns_back
        Mirror turns from the beginning of the first ray's turn to the end of the scan's last.
    range_max
        Metres, the largest that can be sent.
    indices
        Real-time indices, None where the scanner sends none.

    """

    ranges: Array
    intensities: Array | None
    first: float
    step: float
    turns_back: int
    range_max: float
    indices: Indices | None


@dataclass(frozen=True)
class Stream:
    """
    One way to have a scanner's measurements.

    Attributes
    ----------
    kind
        'turns': every mirror turn at once; 'scans': whole scans; 'remission': whole scans with
        remission.
    variant
        What is scanned.
    first, last
        First and last value of a whole scan, counted from 1; None for all.

    """

    kind: Kind
    variant: Variant
    first: int | None = None
    last: int | None = None

    @property
    def by_turn(self) -> bool:
        """Whether a telegram is one mirror turn and says its raster (0x2A, or a part by 0x27)."""
        return self.kind == 'turns' and not self.variant.fast and (
            self.first is None or self.variant.turns > 1)

    @property
    def turns(self) -> int:
        """Mirror turns that one telegram is measured in."""
        return 1 if self.by_turn else self.variant.turns

    @property
    def bounds(self) -> tuple[int, int]:
        """First and last value, counted from 1."""
        return self.first or 1, self.last or self.variant.count

    @property
    def count(self) -> int:
        """Values of the longest telegram."""
        first, last = self.bounds
        if self.by_turn and self.first is None:
            return 181
        return -(-(last - first + 1) // (self.variant.turns if self.by_turn else 1))

    @property
    def request(self) -> SwitchMode:
        """What starts it."""
        first, last = self.bounds
        if self.kind == 'remission' and self.variant.fast:
            return SwitchMode(REMISSION, words(first, last))
        if self.kind == 'remission':
            return SwitchMode(PAIRS, words(1, first, last))
        if self.first is None:
            return SwitchMode(EVERY_TURN if self.by_turn else ALL_VALUES)
        return SwitchMode(SUB_RANGE, words(first | AT_ONCE * self.by_turn, last))

    def telegram_bytes(self, indices: bool) -> int:
        """Return the bytes of a telegram on the line."""
        tail = 2 * indices
        if self.kind == 'remission' and self.variant.fast:
            return 16 + 2 * self.variant.count + self.count + tail
        if self.kind == 'remission':
            return 16 + 4 * self.count + tail
        return (14 if self.first is not None else 10) + 2 * self.count + tail

    def stride(self, rate: int, indices: bool = True) -> int:
        """Return the mirror turns from one telegram to the next: scans are dropped meanwhile."""
        transfer_ns = self.telegram_bytes(indices) * BITS_PER_BYTE * 1_000_000_000 // rate
        return self.turns * math.ceil(transfer_ns / (self.turns * TURN_NS))

    def frequency(self, rate: int, indices: bool = True) -> float:
        """Return the telegrams a second that a line rate in baud carries."""
        return 1e9 / (self.stride(rate, indices) * TURN_NS)

    def measured(
        self, answer: object, mode: MeasuringMode,
    ) -> MeasuredScan | None:
        """
        Return the scan of an answer; None where the answer is not of this stream.

        Parameters
        ----------
        answer
            As decoded.
        mode
            Measuring mode that the scanner's configuration states.

        """
        if isinstance(answer, Scan) and self.kind != 'remission' and self.first is None:
            return self._of_samples(answer.samples, answer.indices, mode)
        if isinstance(answer, SubRange) and (answer.first & ~AT_ONCE, answer.last) == self.bounds:
            return self._of_samples(answer.samples, answer.indices, mode)
        if isinstance(answer, RemissionScan) and self.kind == 'remission':
            return self._of_remission(answer, mode)
        if isinstance(answer, PairScan) and self.kind == 'remission':
            return self._of_pairs(answer, mode)
        return None

    def _geometry(self) -> tuple[float, float, int]:
        """Return first angle, step, and turns back of a whole scan or a part of one."""
        skipped = self.bounds[0] - 1
        return (self.variant.first + skipped * self.variant.step, self.variant.step,
                self.turns - skipped % self.turns)

    def _turn_geometry(self, raster: int) -> tuple[tuple[float, float, int], int]:
        """Return first angle, step, turns back, and the number of values of a single turn."""
        if self.first is None:
            return (0.25 * raster, 1.0, 1), 180 if raster else 181
        first, last = self.bounds
        turn = raster * 25 // self.variant.resolution
        own = range(first - 1 + (turn + 1 - first) % self.variant.turns, last, self.variant.turns)
        return (self.variant.first + own.start * self.variant.step, 1.0, 1), len(own)

    def _of_samples(
        self, samples: Samples, indices: Indices | None, mode: MeasuringMode,
    ) -> MeasuredScan | None:
        raster = samples.raster
        if (raster is not None) != self.by_turn or (raster or 0) * 25 % self.variant.resolution:
            return None
        geometry, expected = self._geometry(), self.count
        if raster is not None:
            geometry, expected = self._turn_geometry(raster)
        if len(samples) != expected:
            return None
        levels = mode.reflector_levels(samples.words)
        return MeasuredScan(mode.ranges(samples.words, samples.unit),
                            None if levels is None else levels.astype(float),
                            *geometry, mode.range_max(samples.unit), indices)

    def _of_remission(self, answer: RemissionScan, mode: MeasuringMode) -> MeasuredScan | None:
        first, last = self.bounds
        if ((answer.first, answer.last) != (first, last)
                or len(answer.remission) != last - first + 1):
            return None
        samples = answer.samples.words
        if len(samples) == self.variant.count:          # distances come of all values
            samples = samples[first - 1:last]
        if len(samples) != last - first + 1:
            return None
        return MeasuredScan(mode.ranges(samples, answer.samples.unit),
                            np.frombuffer(answer.remission, np.uint8).astype(float),
                            *self._geometry(), mode.range_max(answer.samples.unit),
                            answer.indices)

    def _of_pairs(self, answer: PairScan, mode: MeasuringMode) -> MeasuredScan | None:
        if [(r.first, r.last) for r in answer.ranges] != [self.bounds]:
            return None
        pairs, = answer.ranges
        if len(pairs.samples) != 2 * self.count:
            return None
        return MeasuredScan(mode.ranges(pairs.distances, pairs.samples.unit),
                            pairs.remissions.astype(float), *self._geometry(),
                            mode.range_max(pairs.samples.unit), answer.indices)


def make_stream(
    model: Model,
    kind: str,
    angle: int,
    resolution: int,
    first_degree: float = 0.0,
    last_degree: float = 180.0,
) -> Stream:
    """
    Return the stream with some settings that a model has.

    Parameters
    ----------
    model
        Type of the scanner.
    kind
        One of `KINDS`.
    angle, resolution
        Degrees and 1/100 degrees; an S14 has but one of each.
    first_degree, last_degree
        Limits of a part of the scan, 0 to the right and 90 straight ahead.

    Raises
    ------
    LmsSettingError
        Naming what the model has instead.

    """
    if kind not in KINDS:
        raise LmsSettingError(f'stream "{kind}" is unknown; known are {", ".join(KINDS)}')
    if model.fast and resolution in (50, 100):
        variant, = model.variants               # the only one, which also serves the default
    else:
        variant = model.variant(angle, resolution, of_turns=kind == 'turns')
    part = _sub_range(variant, first_degree, last_degree)
    stream = Stream(kind, variant, *part)  # type: ignore[arg-type]
    first, last = stream.bounds
    if stream.by_turn and last - first + 1 < variant.turns:
        raise LmsSettingError(f'{first_degree:g} to {last_degree:g} deg is too narrow for single '
                              'turns: want 1 deg at least, or stream "scans"')
    return stream


def _sub_range(
    variant: Variant, first_degree: float, last_degree: float,
) -> tuple[int, int] | tuple[None, None]:
    """Return the values, counted from 1, nearest to two angles; None for the whole scan."""
    end = variant.first + variant.angle
    low, high = max(first_degree, variant.first), min(last_degree, end)
    if low >= high:
        raise LmsSettingError(
            f'{first_degree:g} to {last_degree:g} deg is no part of the {variant.first:g} to '
            f'{end:g} deg that are scanned (0 is to the right, 90 straight ahead)')
    first = round((low - variant.first) / variant.step) + 1
    last = round((high - variant.first) / variant.step) + 1
    return (None, None) if (first, last) == (1, variant.count) else (first, last)


def rate_table(stream: Stream, indices: bool, fastest: int = max(RATES)) -> str:
    """Return in words how many scans a second each line rate carries."""
    return ', '.join(f'{rate} Bd gives {stream.frequency(rate, indices):.3g} Hz'
                     for rate in sorted(RATES) if rate <= fastest)
