# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The scanner's own beat behind jittery stamps.

A logger that stamps scans when it gets round to them is late by anything up to a few scans; the
mirror is not.  Where stamps scatter, scans are put on a steady beat that follows them slowly;
where they do not, as a driver's of its own clock, they are taken as they are.

A logger that stands still for seconds, then stamps all that has waited at once, looks at first as
if scans were lost.  When the beat turns out to be far ahead of the stamps after it, none was: from
then on stamps may be as late as that, and the beat follows the least late of so many scans.
"""

from __future__ import annotations

from collections import deque
from itertools import islice

import numpy as np

KEPT = 160            # scans over which period, scatter and lateness are told
JUDGED_EVERY = 8      # scans
FEW = 12              # scans before which stamps are taken as they are
MANY = 40             # scans after a pause before which the period is not told anew
SCATTER = 0.1         # of the period, median: beyond, stamps are not believed
GAIN = 0.1            # of a stamp's lateness, by which the beat follows
EARLY_GAIN = 0.5      # where the stamp is before the beat: no scan is stamped before it came
LATE = 2.0            # periods beyond which scans were lost rather than late, at first
MORE = 1.5            # times what was late after all, beyond which they are from then on
PAUSE = 4.0           # periods beyond which the period is to be told anew


class Beat:
    """Times of scans from their stamps."""

    def __init__(self) -> None:
        """Start before the first scan."""
        self._stamps: deque[float] = deque(maxlen=KEPT)
        self._period = np.nan
        self._steady = True
        self._count = 0
        self._time = -np.inf
        self._lateness: deque[float] = deque(maxlen=KEPT)
        self._limit = 0.0           # seconds that stamps may be late
        self._gap = 0.0             # seconds last taken for lost scans

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
        if self._stamps and stamp - self._stamps[-1] > max(PAUSE * self._period, self._limit):
            self._stamps.clear()
        self._stamps.append(stamp)
        self._count += 1
        enough = FEW if np.isnan(self._period) else MANY
        if self._count % JUDGED_EVERY == 0 and len(self._stamps) >= enough:
            self._judge()
        self._time = max(stamp, self._time) if self._steady else self._follow(stamp)
        return self._time

    def _judge(self) -> None:
        stamps = np.array(self._stamps)
        lag = max(len(stamps) // 2, FEW - 4)        # long: stamps in bursts tell it as well
        period = float(np.median(stamps[lag:] - stamps[:-lag])) / lag
        if period == 0.0:           # all have waited for the same
            return
        self._period = period
        scatter = float(np.median(np.abs(np.diff(stamps) - self._period)))
        self._steady = scatter < SCATTER * self._period

    def _follow(self, stamp: float) -> float:
        beat = self._time + self._period
        late = stamp - beat
        if late > max(LATE * self._period, self._limit):
            self._gap = late
            lost = round(late / self._period) * self._period
            beat, late = beat + lost, late - lost
            self._lateness.clear()
        elif late < -LATE * self._period and self._gap:
            self._limit, self._gap = MORE * self._gap, 0.0
        self._lateness.append(late)
        if late < 0.0:                              # time must not turn back
            return beat + max(EARLY_GAIN * late, -0.5 * self._period)
        recent = max(int(MORE * self._limit / self._period), 1)
        least = min(islice(reversed(self._lateness), recent))
        return beat + GAIN * max(least, 0.0)
