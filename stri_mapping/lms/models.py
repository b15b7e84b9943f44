# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The types of the LMS 2xx family and the variants (angle, resolution) that each has."""

from __future__ import annotations

from dataclasses import dataclass

from stri_mapping.errors import LmsError, LmsSettingError


@dataclass(frozen=True)
class Variant:
    """
    What a scanner scans.

    Attributes
    ----------
    angle
        Degrees from the first ray to the last, centred straight ahead.
    resolution
        1/100 degrees between neighbouring rays of a whole scan.
    fast
        Whether one mirror turn measures all of them (the S14); otherwise a turn fires at whole
        degrees and finer steps come from shifting the raster for the next turn.

    """

    angle: int
    resolution: int
    fast: bool = False

    @property
    def turns(self) -> int:
        """Mirror turns of a whole scan: 1, 2 or 4."""
        return 1 if self.fast else 100 // self.resolution

    @property
    def count(self) -> int:
        """Values of a whole scan."""
        return 100 * self.angle // self.resolution + 1

    @property
    def first(self) -> float:
        """Degrees of the first ray, 0 being to the right and 90 straight ahead."""
        return 90.0 - 0.5 * self.angle

    @property
    def step(self) -> float:
        """Degrees between neighbouring rays of a whole scan."""
        return 0.01 * self.resolution

    def __str__(self) -> str:
        """Return it in words."""
        return f'{self.angle} deg at {self.step:g} deg'


HALF_CIRCLE = (Variant(180, 100), Variant(180, 50))
NARROW = (Variant(100, 100), Variant(100, 50), Variant(100, 25))
FAST = (Variant(90, 50, fast=True),)


@dataclass(frozen=True)
class Model:
    """
    One type of scanner.

    Attributes
    ----------
    name
        Such as "LMS291" or "LMS291-S14".
    variants
        What it can scan.

    """

    name: str
    variants: tuple[Variant, ...]

    @property
    def fast(self) -> bool:
        """Whether it is an "LMS Fast", whose variant is fixed."""
        return self.variants == FAST

    def variant(self, angle: int, resolution: int, of_turns: bool = False) -> Variant:
        """
        Return one of its variants.

        Parameters
        ----------
        angle, resolution
            Degrees and 1/100 degrees.
        of_turns
            Whether it is for single turns, which are always 180 degrees wide: then the angle
            need not be one that goes with the resolution.

        Raises
        ------
        LmsSettingError
            Naming those it has.

        """
        fitting = [each for each in self.variants if each.resolution == resolution]
        for each in fitting:
            if each.angle == angle:
                return each
        if of_turns and fitting:
            return fitting[0]
        raise LmsSettingError(f'an {self.name} has no {Variant(angle, resolution)}; it has '
                              f'{", ".join(map(str, self.variants))}')


MODELS = {
    'LMS200': HALF_CIRCLE + NARROW, 'LMS211': NARROW, 'LMS220': HALF_CIRCLE + NARROW,
    'LMS221': HALF_CIRCLE + NARROW, 'LMS291': HALF_CIRCLE + NARROW}
# Which of them also come as "LMS Fast".
FAST_MODELS = ('LMS211', 'LMS221', 'LMS291')


def identify(text: str) -> Model:
    """
    Return the model that a type string such as "LMS200;S18063;V02.19 " names.

    Raises
    ------
    LmsError
        If it names none of the family.

    """
    name, _, rest = text.strip(' \0').partition(';')
    if name not in MODELS:
        raise LmsError(f'the scanner calls itself "{text.strip()}": want one of '
                       f'{", ".join(MODELS)}')
    if name in FAST_MODELS and rest.startswith('S14'):
        return Model(f'{name}-S14', FAST)
    return Model(name, MODELS[name])
