# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Roll, pitch and heave for every ray, as soon as its scan lines' surroundings have told them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.attitude import Attitude, AttitudeSmoother, KNOT_NS
from stri_mapping.facade.points import Rays
from stri_mapping.facade.survey import Evidence, join, Surveyor
from stri_mapping.vehicle import Scanner

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

# Lines further apart than this begin a new stretch: the springs have long forgotten.
LONGEST_PAUSE_NS = 2_000_000_000
# Before any stamp.
LONG_AGO = -(1 << 62)
# Lines of other scanners may still come for this long after a line's time: longest sweep.
SWEEP_NS = 200_000_000


class Stabiliser:
    """
    Turns scan lines into attitudes, stretch by stretch.

    Lines come in the order of their stamps.  After `advance`, attitudes up to `final_ns` are
    final.  The same lines give the same attitudes however they are cut into batches.
    """

    def __init__(self, scanners: Sequence[Scanner]) -> None:
        """Take the vertical scanners."""
        self._surveyor = Surveyor(scanners)
        self._waiting: list[Evidence] = []
        self._smoother: AttitudeSmoother | None = None
        self._done: list[Attitude] = []
        self._last_ns = LONG_AGO

    @property
    def final_ns(self) -> int | None:
        """Time before which attitudes are final; None while no line is waiting for one."""
        return None if self._smoother is None else self._smoother.final_ns

    def add(self, rays: Rays) -> NDArray[np.uint8]:
        """Take the next lines; return the class (n,) of each of their points."""
        begin = rays.first[:-1][np.diff(rays.first) > 0]
        before = np.concatenate([[self._last_ns], rays.stamps_ns[begin[1:] - 1]])
        evidence, label = self._surveyor.survey(rays)
        self._waiting.append(evidence)
        for ray in begin[rays.stamps_ns[begin] - before > LONGEST_PAUSE_NS]:
            self._end_stretch(int(rays.stamps_ns[ray - 1]) if ray else self._last_ns)
            # a line that began earlier may come later, if it took longer
            self._smoother = AttitudeSmoother(int(rays.stamps_ns[ray]) - SWEEP_NS)
        self._last_ns = max(self._last_ns, int(rays.stamps_ns[-1]))
        return label

    def advance(self, known_ns: int) -> None:
        """Make final what can be, given that all lines up to a time have come."""
        if self._smoother is None:
            return
        until = known_ns - SWEEP_NS
        if until > self._last_ns + LONGEST_PAUSE_NS:
            self._end_stretch(self._last_ns)
        else:
            self._smooth((until - self._smoother.start_ns) // KNOT_NS)

    def forget(self, before_ns: int) -> None:
        """Drop the attitudes before a time that nobody will ask for."""
        self._done = [stretch for stretch in self._done if stretch.end_ns > before_ns]
        if self._smoother is not None:
            self._smoother.forget(before_ns)

    def finish(self) -> None:
        """Make everything final: no line will follow."""
        self._end_stretch(self._last_ns)

    def at(self, stamps_ns: Stamps) -> tuple[Array, NDArray[np.bool_]]:
        """
        Return attitudes at times that are final.

        Returns
        -------
        attitude : Array
            (n, 3) roll, pitch in radians, heave in metres; 0 where no line was around.
        told : NDArray[np.bool_]
            (n, 2) whether road or walls told roll and pitch.

        """
        attitude = np.zeros((len(stamps_ns), 3))
        told = np.zeros((len(stamps_ns), 2), dtype=bool)
        if not len(stamps_ns):
            return attitude, told
        current = [] if self._smoother is None else [
            self._smoother.finished(int(stamps_ns.min()))]
        for stretch in [*self._done, *current]:
            stretch.evaluate(stamps_ns, attitude, told)
        return attitude, told

    def _end_stretch(self, last_ns: int) -> None:
        if self._smoother is None:
            return
        self._smooth((last_ns - self._smoother.start_ns) // KNOT_NS + 1)
        self._smoother.finish()
        self._done.append(self._smoother.finished())
        self._smoother = None

    def _smooth(self, intervals: int) -> None:
        """Give the smoother the statements of its next intervals, up to a number of them."""
        assert self._smoother is not None
        new = intervals - self._smoother.intervals
        if new <= 0:
            return
        first = self._smoother.start_ns + self._smoother.intervals * KNOT_NS
        waiting = join(self._waiting)
        order = np.argsort(waiting.stamps_ns, kind='stable')
        borders = first + np.arange(new + 1) * KNOT_NS
        cut = np.searchsorted(waiting.stamps_ns[order], borders)
        for begin, end in zip(cut[:-1], cut[1:]):
            self._smoother.add_interval(waiting, order[begin:end])
        self._waiting = [waiting.take(order[cut[-1]:])]
