# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""When the moments of a recording are due, at a rate that may change, with pauses and steps."""

from __future__ import annotations

from collections.abc import Callable
import time


class Pacer:
    """
    Tells how long to wait for a moment of a recording.

    Parameters
    ----------
    rate
        Speed over that of recording; 0 for no waiting at all.
    clock
        Seconds that only go forward.

    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Start at the recording's beginning, now."""
        self._clock = clock
        self._rate = rate
        self._steps = 0
        self.paused = False
        self.begin(0.0)

    def begin(self, moment: float) -> None:
        """Be at a moment of the recording, in seconds, now."""
        self._then, self._moment = self._clock(), moment

    @property
    def moment(self) -> float:
        """The moment of the recording that has come, in seconds."""
        passed = 0.0 if self.paused else self._clock() - self._then
        return self._moment + passed * self._rate

    @property
    def rate(self) -> float:
        """Speed over that of recording."""
        return self._rate

    @rate.setter
    def rate(self, value: float) -> None:
        self.begin(self.moment)
        self._rate = value

    def pause(self, paused: bool) -> None:
        """Stop at the present moment, or go on from it."""
        self.begin(self.moment)
        self.paused = paused
        self._steps = 0

    def step(self) -> None:
        """While pausing, let one more message pass."""
        self._steps += 1

    def wait(self, moment: float) -> float:
        """Return the seconds until a moment of the recording is due; infinity while pausing."""
        if self.paused:
            return 0.0 if self._steps else float('inf')
        if self._rate == 0.0:
            return 0.0
        return max((moment - self.moment) / self._rate, 0.0)

    def passed(self, moment: float) -> None:
        """Note that the message of a moment was played."""
        if self.paused:
            self._steps = max(self._steps - 1, 0)
            self._moment = moment
        elif self._rate == 0.0:
            self._moment = moment
