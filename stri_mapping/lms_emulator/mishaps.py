# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Faults at work: which are on at a time, and what they do to bytes."""

from __future__ import annotations

import math
import random
from typing import NamedTuple

from stri_mapping.lms_emulator.faults import Fault, Kind

# Faults during which the port is not there, and those during which the line is dead.
AWAY: tuple[Kind, ...] = ('unplug', 'power_cycle')
DEAD: tuple[Kind, ...] = (*AWAY, 'silence')


class _Window(NamedTuple):
    fault: Fault
    begin: float
    end: float


class Mishaps:
    """The faults of one scanner; what they do is drawn from a seed."""

    def __init__(self, seed: int) -> None:
        """Begin with none."""
        self._seed, self._random = seed, random.Random(seed)
        self._windows: list[_Window] = []

    def add(self, fault: Fault, now: float) -> tuple[float, float]:
        """Add a fault whose times count from now; return when it begins and ends."""
        window = _Window(fault, now + fault.at, now + fault.at + fault.duration)
        self._windows = [w for w in self._windows if w.end > now - 1.0] + [window]
        return window.begin, window.end

    def active(self, kinds: tuple[Kind, ...], at: float) -> Fault | None:
        """Return a fault of some kinds that is on at a time."""
        if not self._windows:           # the usual case, and asked for often
            return None
        return next((window.fault for window in self._windows
                     if window.fault.kind in kinds and window.begin <= at < window.end), None)

    def hits(self, kind: Kind, at: float) -> bool:
        """Draw whether a fault of a kind is on and hits this time."""
        fault = self.active((kind,), at)
        return fault is not None and self._random.random() < fault.share

    def spoilt(self, data: bytes, at: float) -> bytes:
        """Return the bytes of a transmission as faults leave them."""
        if not self._windows:
            return data
        spoilt, draw = bytearray(data), self._random.randrange
        if self.hits('crc', at):
            spoilt[draw(len(spoilt))] ^= 1 << draw(8)
        if self.hits('insert', at):
            spoilt.insert(draw(len(spoilt) + 1), draw(256))
        if self.hits('cut', at):
            del spoilt[draw(len(spoilt)):]
        if spoilt and self.hits('drop', at):
            del spoilt[draw(len(spoilt))]
        return bytes(spoilt)

    def late(self, due: float) -> float:
        """Return when bytes that are due reach the host: some seconds are all bursts."""
        fault = self.active(('jitter',), due)
        if fault is None:
            return due
        bursting = random.Random(f'{self._seed} {int(due)}').random() < fault.share
        if bursting and fault.burst > 0.0:
            return math.ceil(due / fault.burst) * fault.burst
        return due + self._random.uniform(0.0, fault.jitter)
