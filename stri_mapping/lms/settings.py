# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What a driver of one scanner can be told; its node's parameters are declared from this."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
import math
from typing import Any

from stri_mapping.errors import UsageError
from stri_mapping.lms.configuration import Configuration
from stri_mapping.lms.measuring import measuring_mode
from stri_mapping.lms.models import Model
from stri_mapping.lms.requests import RATES
from stri_mapping.lms.samples import CENTIMETRES, MILLIMETRES
from stri_mapping.lms.stream import KINDS, make_stream, Stream

UNITS = {'keep': None, 'cm': CENTIMETRES, 'mm': MILLIMETRES}
CHOICES: dict[str, tuple[object, ...]] = {
    'serial_baud': tuple(sorted(RATES)), 'stream': KINDS, 'resolution': (1.0, 0.5, 0.25),
    'scan_angle': (180, 100), 'unit': tuple(UNITS)}


def bounded(default: float, lowest: float, highest: float) -> Any:
    """Return a dataclass field for a number with bounds."""
    return field(default=default, metadata={'range': (lowest, highest)})


@dataclass(frozen=True)
class LmsSettings:
    """
    How a scanner is to be found, set up and read.

    Attributes
    ----------
    serial_port
        Device file, URL of pyserial (socket://host:port, rfc2217://host:port), or a capture.
    serial_baud
        Operating line rate in baud: 9600, 19200, 38400 or 500000 (RS-422).
    stream
        turns: one scan a mirror turn; scans: whole scans, interlaced where finer than 1 degree;
        remission: whole scans with remission, as far as the scanner's type has it.
    resolution
        Degrees between rays of a whole scan: 1.0, 0.5 or 0.25; an LMS-S14 has 0.5 alone.
    scan_angle
        Degrees from the first ray to the last: 180 or 100.  Single turns are always 180 wide.
    angle_min, angle_max
        Radians, 0 straight ahead, counter-clockwise: limits of the part of a scan that the
        scanner is to send; beyond its scan angle they have no effect.
    unit
        Unit in which ranges are sent: cm (80 m), mm (8 to 32 m), or keep for the scanner's own.
    measuring_mode
        Block D of the configuration, 0 to 6: sets range and flags; -1 keeps the scanner's own.
    sensitivity
        Block B of the configuration, 0 to 3 (for a 211, 221, 291 standard, medium, low, high);
        -1 keeps the scanner's own.
    real_time_index
        Whether the scanner is set to number its scans, so that lost ones are known; false keeps
        the scanner's own setting.
    latency
        Seconds from the end of the mirror turn to the first byte on the line.
    time_offset
        Seconds added to every stamp.
    publish_intensity
        Whether remission or reflector levels are published where the mode delivers them.

    Raises
    ------
    UsageError
        Naming the parameter and what would be right.

    """

    serial_port: str = '/dev/ttyUSB0'
    serial_baud: int = 500000
    stream: str = 'turns'
    resolution: float = 1.0
    scan_angle: int = 180
    angle_min: float = bounded(-math.pi / 2, -math.pi, math.pi)
    angle_max: float = bounded(math.pi / 2, -math.pi, math.pi)
    unit: str = 'keep'
    measuring_mode: int = bounded(-1, -1, 15)
    sensitivity: int = bounded(-1, -1, 3)
    real_time_index: bool = True
    latency: float = bounded(0.0, -1.0, 1.0)
    time_offset: float = bounded(0.0, -3600.0, 3600.0)
    publish_intensity: bool = True

    def __post_init__(self) -> None:
        """Check what does not depend on the scanner."""
        for each in fields(self):
            value = getattr(self, each.name)
            low, high = each.metadata.get('range', (-math.inf, math.inf))
            choices = CHOICES.get(each.name)
            if choices is not None and value not in choices:
                raise UsageError(f'parameter {each.name} is {value}: want one of '
                                 f'{", ".join(map(str, choices))}')
            if not isinstance(value, str) and not low <= value <= high:
                raise UsageError(f'parameter {each.name} is {value}: want {low:g} to {high:g}')
        if self.measuring_mode >= 0:
            measuring_mode(self.measuring_mode)

    def configuration(self, present: Configuration) -> Configuration:
        """Return the scanner's configuration with what is to be changed."""
        return present.changed(
            indices=self.real_time_index or None, unit=UNITS[self.unit],
            measuring_mode=None if self.measuring_mode < 0 else self.measuring_mode,
            sensitivity=None if self.sensitivity < 0 else self.sensitivity)

    def wanted_stream(self, model: Model) -> Stream:
        """Return the stream that a model is to be asked for; raises LmsError if it has none."""
        return make_stream(
            model, self.stream, self.scan_angle, round(100 * self.resolution),
            90.0 + math.degrees(self.angle_min), 90.0 + math.degrees(self.angle_max))
