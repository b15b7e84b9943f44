# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
What is left of yaw and of the path's sideways wander, from walls that several scanners see.

The scanners that look ahead, aside and back see the same wall seconds apart.  Each of them lays
small planes (`patches`); what another one sees later ought to lie in them.  By how far it does
not, the pose is corrected, sideways and in yaw.  Both corrections return to zero within a second
where walls do not ask for them: the path as a whole stays what it is.  Along the street walls tell
next to nothing, and nothing is corrected.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.angles import heading
from stri_mapping.facade.knots import Knots
from stri_mapping.facade.patches import Patches
from stri_mapping.facade.points import chosen, concatenate, FacadePoints

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

# Knot interval, nanoseconds, and intervals heard after one before it is final.
KNOT_NS, LAG = 250_000_000, 2
# Standard deviation (m, rad) and correlation time (s) of the corrections.
SIGMA, TIME = np.array([0.01, np.deg2rad(0.1)]), np.array([1.0, 1.0])
# Intervals without lines after which the corrections begin anew.
PAUSE = 8
# A yaw counts as told where it is known this much better than by the prior alone.
TOLD = 0.5
# Knots kept for poses that ask late: those of five minutes.
KEPT = 1200
# A knot that never was: no correction, and not told.
UNTOLD = (np.zeros(2), False)


class _Interval(NamedTuple):
    """Points of one knot interval, with the planar poses (n, 3) they were placed by."""

    number: int
    points: FacadePoints
    poses: Array


class DriftCorrector:
    """
    Corrects points and poses, knot interval by knot interval.

    Points come interval by interval and leave in the same order, some `LAG` intervals later.  With
    fewer than two scanners there is nothing to compare, and they leave at once.

    Parameters
    ----------
    rings
        Number of scanners.

    """

    def __init__(self, rings: int) -> None:
        """Begin without points."""
        self.yaw_told = 0                        # points whose yaw walls told
        self._enabled = rings > 1
        self._patches = Patches(rings if self._enabled else 0)
        self._coming: list[_Interval] = []
        self._waiting: deque[_Interval] = deque()
        self._chain: Knots | None = None
        self._next, self._idle = 0, 0            # interval to come, and those empty before it
        self._oldest = 0                         # number of the chain's oldest knot
        self._fixed: dict[int, tuple[Array, bool]] = {}

    def add(self, points: FacadePoints, poses: Array, first: NDArray[np.int64]) -> None:
        """Take points as placed so far, with their poses (n, 3) and where their lines begin."""
        begin = first[:-1][np.diff(first) > 0]
        numbers = points.stamps_ns[begin] // KNOT_NS
        # lines are in order: those of an interval are together
        cuts = begin[np.flatnonzero(np.diff(numbers, prepend=-1))].tolist()
        for start, stop in zip(cuts, [*cuts[1:], len(points)]):
            own = slice(start, stop)
            self._coming.append(_Interval(int(points.stamps_ns[start] // KNOT_NS),
                                          chosen(points, own), poses[own]))

    def take(self, until_ns: float) -> FacadePoints:
        """Return the points that are final, given all those of before a time; inf for the end."""
        if not self._enabled:
            done, self._coming = self._coming, []
            return concatenate([each.points for each in done])
        until = None if until_ns == np.inf else int(until_ns // KNOT_NS)
        ready = [each for each in self._coming if until is None or each.number < until]
        self._coming = [each for each in self._coming if until is not None
                        and each.number >= until]
        pieces = []
        for number in sorted({each.number for each in ready}):
            pieces += self._advance(number)
            pieces += self._add_interval(_joined(number, ready))
        pieces += self._end() if until is None else self._advance(until)
        return concatenate(pieces)

    def final_ns(self, until_ns: float) -> float:
        """Return the time before which corrections are final, given all points before another."""
        until_ns = min([until_ns, *(each.number * KNOT_NS for each in self._coming)])
        return until_ns if self._chain is None else min(until_ns, self._oldest_interval * KNOT_NS)

    def at(self, stamps_ns: Stamps) -> Array:
        """Return the corrections (n, 3) at final times: poses of the true base_link in the old."""
        found = np.zeros((len(stamps_ns), 3))
        number = stamps_ns // KNOT_NS
        for each in np.unique(number).tolist():
            own = number == each
            found[own, 1:] = self._between(each, stamps_ns[own])
        return found

    @property
    def _oldest_interval(self) -> int:
        """Number of the first interval that is not final."""
        return self._oldest - 1 if self._oldest - 1 in self._fixed else self._oldest

    def _between(self, number: int, stamps_ns: Stamps) -> Array:
        """Return the corrections (n, 2) within an interval, from its two knots."""
        before, after = (self._fixed.get(k, UNTOLD)[0] for k in (number, number + 1))
        return np.asarray(before + _share(number, stamps_ns)[:, None] * (after - before))

    def _advance(self, until: int) -> list[FacadePoints]:
        """Add the intervals without lines up to one; return what becomes final."""
        pieces: list[FacadePoints] = []
        while self._chain is not None and self._next < until:
            self._idle += 1
            pieces += self._end() if self._idle > PAUSE else self._append()
        return pieces

    def _add_interval(self, own: _Interval) -> list[FacadePoints]:
        """Add an interval's points; return what becomes final."""
        self._waiting.append(own)
        if self._chain is None:
            self._chain = Knots(SIGMA, TIME, 1e-9 * KNOT_NS)
            self._chain.append()
            self._next = self._oldest = own.number
        if own.number < self._next:              # late: they take what the others have told
            return self._fix(self._next - LAG)
        self._idle = 0
        return self._append(own)

    def _append(self, own: _Interval | None = None) -> list[FacadePoints]:
        """Add the knot after the next interval and what its points tell."""
        chain = self._chain
        assert chain is not None
        chain.append()
        if own is not None:
            information, vector = self._patches.compare(
                own.points.xyz, own.poses, own.points.stamps_ns, own.points.ring,
                own.points.label, own.number * KNOT_NS, KNOT_NS, chain.solution[-2:])
            chain.information[-4:, -4:] += information
            chain.vector[-4:] += vector
        self._next += 1
        chain.solve()
        return self._fix(self._next - LAG)

    def _end(self) -> list[FacadePoints]:
        """Fix all knots: a pause, or the end."""
        if self._chain is None:
            return []
        pieces = self._fix(self._next)
        self._chain, self._idle = None, 0
        return pieces

    def _fix(self, last: int) -> list[FacadePoints]:
        """Fix the knots up to a number; return the points between those that are."""
        assert self._chain is not None
        while self._oldest <= last:
            value, sigma = self._chain.drop_oldest()
            self._fixed[self._oldest] = value, bool(sigma[1] < TOLD * SIGMA[1])
            self._oldest += 1
        while len(self._fixed) > KEPT:
            del self._fixed[next(iter(self._fixed))]
        pieces = []
        while self._waiting and self._waiting[0].number < last:
            pieces.append(self._corrected(self._waiting.popleft()))
        return pieces

    def _corrected(self, own: _Interval) -> FacadePoints:
        """Return an interval's points where they belong, and remember the walls among them."""
        points, number = own.points, own.number
        if all(self._fixed.get(k, UNTOLD)[1] for k in (number, number + 1)):
            self.yaw_told += len(points)
        before, after = (self._fixed.get(k, UNTOLD)[0] for k in (number, number + 1))
        xyz = _moved(points.xyz, own.poses, points.stamps_ns - number * KNOT_NS, before, after)
        self._patches.add(xyz, points.stamps_ns, points.ring, points.label)
        return FacadePoints(xyz, points.intensity, points.stamps_ns, points.ring, points.label)


@numba.njit(cache=True)
def _moved(xyz, poses, since, before, after):  # type: ignore[no-untyped-def]
    """Return points turned about the vehicle and moved to its left, between two knots."""
    out, known = np.empty_like(xyz), np.full(3, np.nan)
    for i in range(len(xyz)):
        share = min(since[i] / KNOT_NS, 1.0)
        across = before[0] + share * (after[0] - before[0])
        turn = before[1] + share * (after[1] - before[1])
        x, y = xyz[i, 0] - poses[i, 0], xyz[i, 1] - poses[i, 1]
        # a turn of 2 milliradians: the sine is good to 2e-9
        c, s = 1.0 - 0.5 * turn * turn, turn
        cy, sy = heading(poses[i, 2], known)
        out[i, 0] = poses[i, 0] + c * x - s * y - across * sy
        out[i, 1] = poses[i, 1] + s * x + c * y + across * cy
        out[i, 2] = xyz[i, 2]
    return out


def _share(number: int, stamps_ns: Stamps) -> Array:
    """Return where times are within an interval, 0 to 1; lines may last a little longer."""
    return np.minimum((stamps_ns - number * KNOT_NS) / KNOT_NS, 1.0)


def _joined(number: int, pieces: Sequence[_Interval]) -> _Interval:
    """Return all points of one interval."""
    own = [each for each in pieces if each.number == number]
    return own[0] if len(own) == 1 else _Interval(
        number, concatenate([each.points for each in own]),
        np.concatenate([each.poses for each in own]))
