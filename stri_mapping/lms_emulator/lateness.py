# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""How late things happened: counted, however many there are."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import accumulate
import math

# The first bin ends 10 % above 10 microseconds, the last one beyond a minute.
FIRST, STEP, BINS = 1e-5, math.log(1.1), 170


@dataclass(frozen=True)
class Figures:
    """Lateness in seconds: how many there were, median, 99 %, worst."""

    count: int = 0
    p50: float = 0.0
    p99: float = 0.0
    worst: float = 0.0

    def __str__(self) -> str:
        """Return it in words."""
        return (f'p50 {1e3 * self.p50:.2f} ms, p99 {1e3 * self.p99:.2f} ms, '
                f'max {1e3 * self.worst:.2f} ms')


@dataclass
class Lateness:
    """
    A histogram of lateness, in steps of 10 per cent.

    Attributes
    ----------
    count
        Things that happened.
    worst
        Seconds.

    """

    count: int = 0
    worst: float = 0.0
    _bins: list[int] = field(default_factory=lambda: [0] * BINS)

    def add(self, seconds: float) -> None:
        """Take one in."""
        self.count += 1
        self.worst = max(self.worst, seconds)
        steps = math.log(seconds / FIRST) / STEP if seconds > FIRST else 0.0
        self._bins[min(int(steps), BINS - 1)] += 1

    def quantile(self, share: float) -> float:
        """Return the lateness in seconds that a share of all did not exceed; 0 for none."""
        if self.count == 0:
            return 0.0
        index = next(k for k, total in enumerate(accumulate(self._bins))
                     if total >= share * self.count)
        return min(FIRST * math.exp((index + 1) * STEP), self.worst)

    @property
    def figures(self) -> Figures:
        """What is to be told of it."""
        return Figures(self.count, self.quantile(0.5), self.quantile(0.99), self.worst)
