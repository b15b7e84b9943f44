# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What goes wrong, and when: a plan of faults for one emulated scanner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, get_args, Literal

import yaml

from stri_mapping.errors import UsageError
from stri_mapping.lms.requests import RATES

Kind = Literal['crc', 'drop', 'insert', 'cut', 'silence', 'nak', 'miss', 'jitter', 'reset',
               'unplug', 'power_cycle', 'wrong_rate', 'streaming']
KINDS: tuple[Kind, ...] = get_args(Kind)
Since = Literal['start', 'stream']


@dataclass(frozen=True)
class Fault:
    """
    One fault for some time.

    Attributes
    ----------
    kind
        'crc': a bit of a transmission is flipped; 'drop', 'insert': it loses a byte, or gets one
        too many; 'cut': it ends early.  'silence': nothing is sent or heard.  'nak': requests are
        refused as garbled; 'miss': they are not noticed.  'jitter': bytes reach the host late.
        'reset': the scanner starts anew at `at`, the line stays.  'unplug': the port is gone for
        the time, the scanner runs on.  'power_cycle': the port is gone and the scanner without
        power.  'wrong_rate', 'streaming': from `at` on the line rate is `rate`, or the scanner
        sends, though no host has asked for it; with `at` 0 it is found so.
    at
        Seconds at which it begins.
    duration
        Seconds it lasts; a 'reset' lasts as long as the scanner takes to start, 'wrong_rate' and
        'streaming' until a host changes that.
    share
        Of the transmissions ('crc', 'drop', 'insert', 'cut') or requests ('nak', 'miss') that are
        hit, and of the seconds with bursts ('jitter'), 0 to 1.
    jitter, burst
        Of 'jitter': bytes are late by up to `jitter` seconds, evenly spread; in bursts all that
        comes within `burst` seconds is handed on together.
    rate
        Of 'wrong_rate', baud.
    since
        'start': `at` counts from the emulator's start; 'stream': from the first scan it sent.

    Raises
    ------
    UsageError
        If a value is out of range.

    """

    kind: Kind
    at: float = 0.0
    duration: float = 1.0
    share: float = 1.0
    jitter: float = 0.005
    burst: float = 0.016
    rate: int = 38400
    since: Since = 'start'

    def __post_init__(self) -> None:
        """Check every field."""
        if self.kind not in KINDS:
            raise UsageError(f'fault kind is {self.kind!r}; known are {", ".join(KINDS)}')
        if self.since not in get_args(Since):
            raise UsageError(f'fault since is {self.since!r}; want start or stream')
        if self.rate not in RATES:
            raise UsageError(f'fault rate is {self.rate!r}; want {", ".join(map(str, RATES))}')
        for name, high in (('at', 1e9), ('duration', 1e9), ('share', 1.0), ('jitter', 1.0),
                           ('burst', 1.0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise UsageError(f'fault {name} is {value!r}: want a number')
            if not 0.0 <= value <= high:
                raise UsageError(f'fault {name} is {value}: want 0 to {high:g}')


def read_plans(path: Path) -> dict[str, list[Fault]]:
    """
    Read the plans of some scanners from YAML or JSON.

    The file is a mapping: by the scanner's name, a list of faults with the fields of `Fault`::

        horizontal:
          - {kind: crc, at: 5.0, duration: 2.0, share: 0.5}
          - {kind: power_cycle, at: 10.0, duration: 3.0}

    Raises
    ------
    UsageError
        Naming the file, the scanner, the fault, and what would be right.

    """
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise UsageError(f'{path}: {error.strerror}') from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f'{path}: not YAML: {" ".join(str(error).split())}') from None
    if not isinstance(content, dict):
        raise UsageError(f'{path}: want a mapping of scanner names to lists of faults')
    return {str(name): _plan(f'{path}: {name}', entries) for name, entries in content.items()}


def _plan(where: str, entries: Any) -> list[Fault]:
    if not isinstance(entries, list):
        raise UsageError(f'{where}: want a list of faults')
    return [_fault(f'{where}[{index}]', entry) for index, entry in enumerate(entries)]


def _fault(where: str, entry: Any) -> Fault:
    known = [field.name for field in fields(Fault)]
    if not isinstance(entry, Mapping) or 'kind' not in entry:
        raise UsageError(f'{where}: want a mapping with kind and any of {", ".join(known[1:])}')
    for key in entry:
        if key not in known:
            raise UsageError(f'{where}: unknown key {key!r}; known are {", ".join(known)}')
    try:
        return Fault(**entry)
    except UsageError as error:
        raise UsageError(f'{where}: {error}') from None
