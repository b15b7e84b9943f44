# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Scans with the host's time of their first ray, from the mirror's clock."""

from __future__ import annotations

from dataclasses import dataclass
import logging
import time

from stri_mapping.lms.clock import MirrorClock
from stri_mapping.lms.stream import MeasuredScan, Stream

# Nanoseconds by which the host's time of day must have been set to be followed (readings of it
# scatter), and to be spoken of.
STEP_NS, SAID_STEP_NS = 100_000, 10_000_000
logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class TimedScan:
    """
    One scan with the host's time of its first ray.

    Attributes
    ----------
    stamp_ns
        Nanoseconds of the host's time of day.
    scan
        What was measured.
    time_increment
        Seconds from ray to ray; 0 where rays of several mirror turns are interlaced.
    scan_time
        Seconds from scan to scan.

    """

    stamp_ns: int
    scan: MeasuredScan
    time_increment: float
    scan_time: float


class Stamper:
    """
    Dates the scans of one stream, in order.

    Parameters
    ----------
    latency
        Seconds from the end of a scan's last mirror turn to the first byte on the line.
    time_offset
        Seconds added to every stamp.

    Attributes
    ----------
    clock
        The mirror's.
    dated
        Scans that got a time.
    withheld
        Scans whose time came out no later than that of the scan before.
    host_offset
        Nanoseconds by which the host's time of day is ahead of its steady clock.
    lost
        Scans that were measured since the first one and did not get here, outages included.

    """

    def __init__(self, latency: float = 0.0, time_offset: float = 0.0) -> None:
        """Start without a stream."""
        self.clock = MirrorClock()
        self.dated = self.withheld = 0
        self._latency, self._time_offset = latency, time_offset
        self._last_ray: int | None = None       # first ray of the newest scan, steady time
        self._outages, self._interrupted = 0, False
        self._last_byte: int | None = None      # first byte of the newest scan, steady time
        self.host_offset = 0

    @property
    def lost(self) -> int:
        """Scans lost so far."""
        return self.clock.lost + self._outages

    def computed_latency(self, turns_back: int, first: float) -> float:
        """Return the seconds from the first ray, at so many degrees, to the first byte."""
        return 1e-9 * self.clock.turn_ns * (turns_back - first / 360.0) + self._latency

    def restart(self, stride: int) -> None:
        """Begin a stream of one telegram in so many mirror turns; it goes on where it can."""
        self.clock.restart(stride)
        self._interrupted = True

    def pause(self) -> None:
        """Count nothing as lost that would have come until the next `restart`."""
        self._last_byte = None

    def date(
        self, scan: MeasuredScan, stream: Stream, begin_ns: int, disturbed: bool,
    ) -> TimedScan | None:
        """
        Return a scan with its time.

        Parameters
        ----------
        scan, stream
            What came, and of which stream.
        begin_ns
            When its telegram began to arrive at the latest, on the steady clock.
        disturbed
            Whether anything but telegrams came since the scan before.

        Returns
        -------
        TimedScan or None
            None for a scan that came twice, while the clock settles, and where its time is not
            after the last one's.

        """
        index = None if scan.indices is None else scan.indices.turn
        first_byte = self.clock.observe(begin_ns, index, disturbed)
        if first_byte is None:
            return None
        self._count_outage(first_byte)
        turn = 1e-9 * self.clock.turn_ns
        self._follow_host()
        ray = first_byte - round(1e9 * self.computed_latency(scan.turns_back, scan.first))
        if self._last_ray is not None and ray <= self._last_ray:
            self.withheld += 1
            return None
        self._last_ray = ray
        self.dated += 1
        stamp = ray + self.host_offset + round(1e9 * self._time_offset)
        increment = turn * scan.step / 360.0 if stream.turns == 1 else 0.0
        return TimedScan(stamp, scan, increment, turn * self.clock.stride)

    def _follow_host(self) -> None:
        """Follow steps of the host's time of day, and say so."""
        offset = host_offset()
        step = offset - self.host_offset
        if abs(step) < STEP_NS:
            return
        if self.host_offset and abs(step) > SAID_STEP_NS:
            logger.warning('the time of day was set by %+.3f s, and the stamps with it',
                           step * 1e-9)
        self.host_offset = offset

    def _count_outage(self, first_byte: int) -> None:
        """Count the scans that an interruption of the stream has cost."""
        if self._interrupted and self._last_byte is not None:
            turns = (first_byte - self._last_byte) / self.clock.turn_ns
            self._outages += max(round(turns / self.clock.stride) - 1, 0)
        self._interrupted, self._last_byte = False, first_byte


def host_offset() -> int:
    """
    Return by how many nanoseconds the host's time of day is ahead of its steady clock.

    Of three readings, the one that was interrupted the least counts.
    """
    best, offset = 0, 0
    for _ in range(3):
        before = time.monotonic_ns()
        now = time.time_ns()
        took = time.monotonic_ns() - before
        if not best or took < best:
            best, offset = took, now - before - took // 2
    return offset
