# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The scanner's own beat behind jittery stamps.

A logger that stamps scans when it gets round to them is late by anything up to a few scans; the
mirror is not.  Where stamps scatter, scans are put on a steady beat that follows them slowly;
where they do not, as a driver's of its own clock, they are taken as they are.
"""

from __future__ import annotations

from collections import deque

import numpy as np

KEPT = 40             # scans over which period and scatter are told
LAG = 8               # scans whose time together tells the period
FEW = 12              # scans before which stamps are taken as they are
SCATTER = 0.1         # of the period, median: beyond, stamps are not believed
GAIN = 0.1            # of a stamp's difference from the beat, by which the beat follows
LATE = 2.0            # periods beyond which scans were lost rather than late
PAUSE = 4.0           # periods beyond which the period is told anew


class Beat:
    """Times of scans from their stamps."""

    def __init__(self) -> None:
        """Start before the first scan."""
        self._stamps: deque[float] = deque(maxlen=KEPT)
        self._period = np.nan
        self._steady = True
        self._count = 0
        self._time = -np.inf

    def add(self, stamp: float) -> float:
        """
        Take the next scan.

        Parameters
        ----------
        stamp
            Seconds; rising.

        Returns
        -------
        float
            The scan's time in seconds, on the same clock; rising.

        """
        if self._stamps and stamp - self._stamps[-1] > PAUSE * self._period:
            self._stamps.clear()
        self._stamps.append(stamp)
        self._count += 1
        if self._count % LAG == 0 and len(self._stamps) >= FEW:
            self._judge()
        self._time = max(stamp, self._time) if self._steady else self._follow(stamp)
        return self._time

    def _judge(self) -> None:
        stamps = np.array(self._stamps)
        self._period = float(np.median(stamps[LAG:] - stamps[:-LAG])) / LAG
        scatter = float(np.median(np.abs(np.diff(stamps) - self._period)))
        self._steady = scatter < SCATTER * self._period

    def _follow(self, stamp: float) -> float:
        late = stamp - self._time - self._period
        lost = round(late / self._period) if late > LATE * self._period else 0
        beat = self._time + (1 + lost) * self._period
        # a stamp far before the beat must not turn time back
        return beat + max(GAIN * (stamp - beat), -0.5 * self._period)
