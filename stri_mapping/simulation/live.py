# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
A virtual drive at true times: rays are cast ahead of time, in batches, scanner by scanner.

The motion of a virtual vehicle is known ahead, so what its scanners will see can be too.  Times
are real seconds since a start of the caller's choice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from stri_mapping.lms_emulator.process import Turns, Want
from stri_mapping.simulation.drive import Drive
from stri_mapping.simulation.scanner import VirtualScanner
from stri_mapping.simulation.timeline import make_timeline, Timeline

Array = NDArray[np.float64]

# Turns of a mirror that are cast together, and seconds by which casting is ahead: it is over
# long before, and a process that others keep from running for half a second is not late.
BATCH, AHEAD = 24, 1.0
# Finer than anything a scanner sends: it is the scanner's output that rounds.
EXACT = 1e-4


@dataclass
class _Channel:
    """How far one scanner has been cast; None while nobody wants its scans."""

    scanner: VirtualScanner
    next_turn: int | None = None

    @property
    def done_until(self) -> float:
        assert self.next_turn is not None
        return self.scanner.phase + self.scanner.period * self.next_turn


class LiveDrive:
    """
    A vehicle that stands still until it is told to go, and casts what its scanners will see.

    Attributes
    ----------
    timeline
        Of the drive; it begins never until `go`.

    """

    def __init__(self, drive: Drive, first: float = 0.0) -> None:
        """Take a drive, and the second of its scene at which the vehicle stands at first."""
        self.drive = drive
        self.timeline: Timeline = make_timeline(drive.scene.motion, first, drive.scene.duration)
        self._channels = [_Channel(scanner) for scanner in drive.scanners]
        for scanner in drive.scanners:
            scanner.model = replace(scanner.model, quantisation=EXACT)
            scanner.scene_time = lambda times: self.timeline.scene(times)

    def want(self, index: int, what: Want | None, now: float) -> None:
        """
        Cast for one scanner from now on what it measures; nothing for None.

        On the drive all goes on being cast: a driver that comes back finds its scans.
        """
        channel = self._channels[index]
        if what is None:
            if math.isinf(self.timeline.begin):
                channel.next_turn = None
            return
        model = replace(channel.scanner.model, field=what.field, resolution=what.resolution)
        if model != channel.scanner.model or channel.next_turn is None:
            channel.scanner.model = model
            channel.next_turn = self._turn_at(channel, now)

    def go(self, at: float) -> None:
        """Begin to move, not before `at` nor in what has been cast already."""
        cast = [c.done_until for c in self._channels if c.next_turn is not None]
        self.timeline = replace(self.timeline, begin=max([at, *cast]))

    def cast(self, now: float) -> Turns | None:
        """Return the most urgent batch; None if all is cast that is wanted for a while."""
        wanted = [c for c in self._channels if c.next_turn is not None]
        if not wanted:
            return None
        channel = min(wanted, key=lambda c: c.done_until)
        if channel.done_until > now + AHEAD:
            return None
        # what is over already is of no use any more
        first = max(channel.next_turn or 0, self._turn_at(channel, now))
        channel.next_turn = first + BATCH
        scans = [timed.scan for timed in channel.scanner.turns(first, first + BATCH)]
        remission = [s.intensities.astype(np.float32) for s in scans if s.intensities is not None]
        model = channel.scanner.model
        return Turns(self._channels.index(channel), Want(model.field, model.resolution), first,
                     [s.ranges.astype(np.float32) for s in scans],
                     remission if len(remission) == len(scans) else None)

    def poses(self, times: Array) -> tuple[Array, Array]:
        """
        Return the true poses and velocities of base_link at real times (n,).

        Returns
        -------
        poses, twists : Array
            (n, 6) as `Motion.at` and `Motion.twist` give them.

        """
        motion, scene = self.drive.scene.motion, self.timeline.scene(times)
        return motion.at(scene), motion.twist(scene) * self.timeline.rate(times)[:, None]

    @staticmethod
    def _turn_at(channel: _Channel, now: float) -> int:
        """Return the number of the turn that is under way."""
        return max(0, int((now - channel.scanner.phase) // channel.scanner.period))
