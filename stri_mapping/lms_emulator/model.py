# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The types of scanner that can be emulated, and the state that a scanner keeps."""

from __future__ import annotations

from dataclasses import dataclass, field

from stri_mapping.errors import UsageError
from stri_mapping.lms.configuration import Configuration, FACTORY
from stri_mapping.lms.requests import ALL_VALUES, EVERY_TURN, ON_REQUEST, PASSWORD
from stri_mapping.lms.samples import CENTIMETRES
from stri_mapping.lms.status import RATE_WORDS, Status
from stri_mapping.lms_emulator.turns import Mirror, Variant

# Bytes that leave within a turn at 500 kBd (TL 10.10); an S14 sends a whole scan, indices and all.
BURST, BURST_S14 = 508, 561
RATE_CODES = {rate: word for word, rate in RATE_WORDS.items()}
OUTDOOR = FACTORY.changed(unit=CENTIMETRES)


@dataclass(frozen=True)
class Model:
    """
    A type of scanner.

    Attributes
    ----------
    text
        Type string, 21 characters.
    variants
        Angles and resolutions it takes; the first is the one after power-on.
    configuration
        Factory settings.
    burst
        Bytes it sends within one turn of the mirror at 500 kBd, at most.

    """

    text: str
    variants: tuple[Variant, ...]
    configuration: Configuration
    burst: int = BURST

    @property
    def fast(self) -> bool:
        """Whether it is an S14: 90 degrees in steps of 0.5 in every turn, with remission."""
        return self.variants[0].angle == 90

    @property
    def stream(self) -> int:
        """The mode in which a killed driver leaves it streaming: every turn, where it can."""
        return ALL_VALUES if self.fast else EVERY_TURN


_HALF = (Variant(180, 50), Variant(180, 100), Variant(100, 100), Variant(100, 50),
         Variant(100, 25))
MODELS = {
    'LMS200': Model('LMS200;301063;V02.10 ', _HALF, FACTORY),
    'LMS211': Model('LMS211;302063;V02.10 ', (Variant(100, 50), Variant(100, 100),
                                              Variant(100, 25)), OUTDOOR),
    'LMS220': Model('LMS220;301063;V02.10 ', _HALF, FACTORY),
    'LMS221': Model('LMS221;302063;V02.10 ', _HALF, OUTDOOR),
    'LMS291': Model('LMS291;S05063;V02.10 ', _HALF, OUTDOOR),
    'LMS291-S14': Model('LMS291;S14063;V02.10 ', (Variant(90, 50),), OUTDOOR, burst=BURST_S14),
}


@dataclass
class Memory:
    """
    What a scanner knows: some of it survives a reset, some a power cycle.

    Attributes
    ----------
    model
        Its type.
    serial_number
        Eight digits.
    configuration
        Kept in EEPROM.
    keep
        Behaviour at power-on: 0 nothing is kept, 1 the line rate, 2 the variant.
    rate, mode, variant
        Line rate in baud, operating mode, scanned angle and resolution.
    writes
        How often the EEPROM was written.
    address
        Of the scanner on its line; it also hears what is for any.
    password
        Of the installation mode.

    """

    model: Model = MODELS['LMS291']
    serial_number: str = '00000001'
    rate: int = 9600
    mode: int = ON_REQUEST
    configuration: Configuration = field(default=OUTDOOR)
    variant: Variant = field(default=Variant())
    keep: int = 0
    writes: int = 0
    address: int = 1
    password: bytes = PASSWORD

    def restart(self) -> None:
        """Forget what a reset or a power cycle makes a scanner forget."""
        self.mode = ON_REQUEST
        if self.keep != 1:
            self.rate = 9600
        if self.keep != 2:
            self.variant = self.model.variants[0]

    def status(self, mirror: Mirror) -> Status:
        """Return the answer to a request for the status."""
        return Status(
            firmware=self.model.text[-7:].rstrip(), mode=self.mode,
            serial_number=self.serial_number, pollution=(402,) * 8, reference=(282,) * 4,
            pollution_calibration=(432,) * 8, reference_calibration=(300,) * 4,
            motor=round(1e6 * mirror.period / 90.0), laser_power=100,
            measuring_mode=self.configuration.measuring_mode, angle=self.variant.angle,
            resolution=self.variant.resolution, rate_word=RATE_CODES[self.rate],
            keeps_rate=int(self.keep == 1), unit=self.configuration.unit, boot_prom='V02.02')


def make_memory(name: str, rate: int = 9600, streaming: bool = False) -> Memory:
    """
    Return the state in which a host finds a scanner of a type.

    Parameters
    ----------
    name
        Key of `MODELS`.
    rate
        Line rate, baud.
    streaming
        Whether it sends scans already, as a killed driver leaves it.

    Raises
    ------
    UsageError
        If there is no such type or rate.

    """
    if name not in MODELS:
        raise UsageError(f'unknown scanner type "{name}"; known are {", ".join(MODELS)}')
    if rate not in RATE_CODES:
        raise UsageError(f'line rate is {rate}: want {", ".join(map(str, sorted(RATE_CODES)))}')
    model = MODELS[name]
    return Memory(model, rate=rate, mode=model.stream if streaming else ON_REQUEST,
                  configuration=model.configuration, variant=model.variants[0])
