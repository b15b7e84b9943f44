# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The mirror as a clock: times of its turns from the arrival of telegrams.

The mirror turns evenly, 13.32 ms a turn within some 100 ppm and drifting slowly, while a telegram
arrives late by whatever adapter, kernel and scheduler add, and never early.  In the plane of turn
number and arrival the truth is therefore a line below all points that many points come close to.
Of all lines below the points, the one with the least sum of distances is an edge of their lower
convex hull: the one below their mean turn (Moon, Skelly, Towsley 1999, "Estimation and removal of
clock skew from network delay measurements").
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math

# Nominal nanoseconds of a mirror turn, and by which share a real mirror can be off.
TURN_NS = 13_320_000
TOLERANCE = 5e-3
# Turns over which the line is fitted (20 s): enough for many timely arrivals, and short enough
# for a mirror whose speed drifts by 10 ppm a minute to bend by under 0.1 ms.
WINDOW = 1500
# Turns of which only the most timely arrival is kept.
BIN = 16
# Turns before times are given out (the first telegrams may all be late ones), and turns before
# the slope is fitted: over less, lateness tells less of it than the nominal speed does.
SETTLED, SLOPED = 20, 75
# Nanoseconds by which no arrival is early: where one is, the scanner has begun to count anew.
EARLY_NS = TURN_NS // 2
# Without real-time indices a scan counts as lost when so many telegrams in succession came late
# by most of a scan (jitter would have let one of them be timely), or one came late by more than
# any of the last ones, or by more nanoseconds than adapters hold bytes back.
LATE_RUN, LATE_MEMORY, LATE_NS = 24, 256, 60_000_000
MOST = 0.85
INDEX_MODULUS = 256


@dataclass
class Jitter:
    """Root mean square of deviations, in nanoseconds, fading with a memory of 256 of them."""

    mean_square: float = 0.0
    count: int = 0

    def add(self, deviation: float) -> None:
        """Take in one deviation."""
        self.count = min(self.count + 1, 256)
        self.mean_square += (deviation**2 - self.mean_square) / self.count

    @property
    def rms(self) -> float:
        """Nanoseconds."""
        return math.sqrt(self.mean_square)


class MirrorClock:
    """
    The times of mirror turns, as a line under their telegrams' arrivals.

    All times are integer nanoseconds of one steady clock: steps of the host's time of day never
    come in here.

    Parameters
    ----------
    stride
        Mirror turns from one telegram to the next where none is lost.

    Attributes
    ----------
    lost
        Scans that were due and did not come.
    restarts
        How often the fit was begun anew.
    arrival_jitter, fit_jitter
        Deviations from even turns of the arrivals, and of the times given out.

    """

    def __init__(self, stride: int = 1) -> None:
        """Start without a turn."""
        self.lost = self.restarts = 0
        self.arrival_jitter, self.fit_jitter = Jitter(), Jitter()
        self.stride = stride
        self._reset()

    def _reset(self) -> None:
        self._turn = -1                         # number of the newest turn, the first being 0
        self._index: int | None = None          # its real-time index
        self._origin = 0                        # arrival of turn 0
        self._bins: deque[tuple[int, int]] = deque()     # most timely (turn, residual) by bin
        self._slope, self._offset = 0.0, 0.0    # line of residuals over turns
        self._late: deque[float] = deque(maxlen=LATE_MEMORY)
        self._previous: tuple[int, int, int] | None = None      # turn, arrival, time

    @property
    def turn_ns(self) -> float:
        """Nanoseconds of a turn as fitted."""
        return TURN_NS + self._slope

    def restart(self, stride: int | None = None) -> None:
        """Begin anew, because the stream was interrupted; with another stride where given."""
        self.restarts += self._turn >= 0
        self.stride = stride or self.stride
        self._reset()

    def observe(self, arrival_ns: int, index: int | None, disturbed: bool = False) -> int | None:
        """
        Take in one telegram.

        Parameters
        ----------
        arrival_ns
            When its first byte began to arrive at the latest.
        index
            Real-time index of its last turn, modulo 256; None where the scanner sends none.
        disturbed
            Whether anything but telegrams came since the last: then one may be missing.

        Returns
        -------
        int or None
            When the telegram would have begun to arrive if it were not late: its turn's time,
            with a delay that is the same for all.  None for a turn already seen, and until the
            line has settled.

        """
        if self._turn < 0:
            self._turn, self._index, self._origin = 0, index, arrival_ns
        else:
            steps = self._steps(arrival_ns, index, disturbed)
            if steps <= 0:
                return None
            self.lost += max(steps // self.stride - 1, 0)
            self._turn, self._index = self._turn + steps, index
        if index is not None and self._earliness(arrival_ns) > EARLY_NS and self._settled:
            self.restart()                      # the scanner has begun to count anew
            return self.observe(arrival_ns, index)
        self._fit(arrival_ns - self._origin - self._turn * TURN_NS)
        return self._given_out(arrival_ns)

    @property
    def _settled(self) -> bool:
        return self._turn >= SETTLED

    def _time(self, turn: int) -> float:
        return self._origin + turn * TURN_NS + self._offset + self._slope * turn

    def _earliness(self, arrival_ns: int) -> float:
        return self._time(self._turn) - arrival_ns

    def _steps(self, arrival_ns: int, index: int | None, disturbed: bool) -> int:
        """Return how many turns after the newest one this telegram's turn is."""
        elapsed = (arrival_ns - self._time(self._turn)) / self.turn_ns
        if index is not None and self._index is not None:
            steps = (index - self._index) % INDEX_MODULUS
            return steps + INDEX_MODULUS * round((elapsed - steps) / INDEX_MODULUS)
        return self._counted_steps(elapsed / self.stride, disturbed) * self.stride

    def _counted_steps(self, scans: float, disturbed: bool) -> int:
        """Return the scans since the newest one, given the arrival's distance from it in scans."""
        late = scans - 1.0
        if not self._settled:
            return 1
        if late < MOST - 1.0:
            back = math.ceil(-late)             # impossible: so many were counted in error
            self.lost -= back
            self._turn -= back * self.stride
            while self._bins and self._bins[-1][0] > self._turn:
                self._bins.pop()
            return 1
        missed = 0
        if late > MOST and (disturbed or self._unheard_of(late)):
            missed = math.floor(late + 1.0 - MOST)
        self._late.append(late - missed)
        return 1 + missed

    def _unheard_of(self, late: float) -> bool:
        """Return whether a telegram so many scans late shows that one before it is missing."""
        if late * self.stride * TURN_NS > LATE_NS or max(self._late, default=0.0) < 1.0 - MOST:
            return True
        run = list(self._late)[-LATE_RUN:]
        return len(run) == LATE_RUN and min(run) > MOST

    def _fit(self, residual: int) -> None:
        """Take in the newest turn's arrival, relative to nominal turns."""
        bins, turn = self._bins, self._turn
        complete = not bins or turn // BIN != bins[-1][0] // BIN
        if complete:
            bins.append((turn, residual))
            while bins[0][0] < turn - WINDOW:
                bins.popleft()
        elif residual < bins[-1][1]:
            bins[-1] = (turn, residual)
        if complete or residual < self._offset + self._slope * turn:
            self._slope, self._offset = lowest_line(bins, turn >= SLOPED)

    def _given_out(self, arrival_ns: int) -> int | None:
        """Return the newest turn's time, once the line has settled."""
        time_ns = round(self._time(self._turn))
        if self._previous is not None:
            turn, arrival, time = self._previous
            even = (self._turn - turn) * self.turn_ns
            self.arrival_jitter.add(arrival_ns - arrival - even)
            self.fit_jitter.add(time_ns - time - even)
        if not self._settled:
            return None
        self._previous = (self._turn, arrival_ns, time_ns)
        return time_ns


def lowest_line(points: deque[tuple[int, int]], sloped: bool) -> tuple[float, float]:
    """
    Return slope and offset of the line below all points with the least sum of distances.

    Parameters
    ----------
    points
        (turn, residual in nanoseconds) with rising turns.
    sloped
        Whether to fit the slope, within `TOLERANCE`; otherwise it is 0.

    """
    slope = 0.0
    if sloped and len(points) > 1:
        left, right = _edge(points, sum(turn for turn, _ in points) / len(points))
        slope = (right[1] - left[1]) / (right[0] - left[0])
        slope = min(max(slope, -TOLERANCE * TURN_NS), TOLERANCE * TURN_NS)
    return slope, min(residual - slope * turn for turn, residual in points)


def _edge(points: deque[tuple[int, int]], at: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the edge of the lower convex hull below `at` (Andrew's monotone chain)."""
    hull: list[tuple[int, int]] = []
    for point in points:
        while len(hull) > 1 and _above(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    for left, right in zip(hull, hull[1:]):
        if right[0] >= at:
            return left, right
    return hull[-2], hull[-1]


def _above(left: tuple[int, int], middle: tuple[int, int], right: tuple[int, int]) -> bool:
    """Return whether the middle point is on or above the line from left to right."""
    return ((middle[1] - left[1]) * (right[0] - left[0])
            >= (right[1] - left[1]) * (middle[0] - left[0]))
