# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""An aligner in the place of one that was killed: the same scans and poses, no point twice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from stri_mapping.facade.cloud_files import last_times
from stri_mapping.facade.journal import COUNTS, counts_of, KEPT_NS, POSES, poses_of, Record, SCAN
from stri_mapping.facade.points import chosen, concatenate, FacadePoints
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.scan import Scan


class Takeover:
    """
    Feeds a new aligner with what the killed one had taken, and knows which points are new.

    Lines leave an aligner whole, and those of one scanner in the order in which they came.  So all
    points of a scanner up to the last one of it in the cloud are there, and none after it.

    Parameters
    ----------
    aligner
        New; is fed, and gets the counts of the killed one.
    records
        What the killed one took, oldest first.
    cloud
        First file of the cloud that it wrote.
    scan_of
        Returns the scan of a serialised message.

    Attributes
    ----------
    scans
        Number of scans that were fed.
    newest
        Stamp in nanoseconds and yaw of the newest pose that was fed; zeros where none was.

    """

    def __init__(self, aligner: FacadeAligner, records: Sequence[Record], cloud: Path,
                 scan_of: Callable[[bytes], Scan]) -> None:
        """Feed the aligner."""
        self.scans, self.newest = 0, (0, 0.0)
        self._aligner, self._scan_of = aligner, scan_of
        begin = min((r.stamp_ns for r in records if r.kind == SCAN), default=0)
        # by ring: time in seconds of the last point in the cloud
        self._last = last_times(cloud, 1e-9 * begin) if records else {}
        self._context_ns = round(1e9 * max(self._last.values(), default=0.0)) - KEPT_NS
        counted = max((i for i, r in enumerate(records) if r.kind == COUNTS), default=0)
        for record in records[:counted]:
            self._feed(record)
        # what the killed one has counted is placed, and not to be counted again
        self._held = aligner.take_points()
        for record in records[counted:]:
            self._feed(record)

    def _feed(self, record: Record) -> None:
        if record.kind == COUNTS:
            self._aligner.counts = counts_of(record)
        elif record.kind == POSES:
            stamps, poses = poses_of(record)
            self._aligner.add_poses(stamps, poses)
            self.newest = int(stamps[-1]), float(poses[-1, 2])
        elif record.stamp_ns > min(self._context_ns, 1e9 * self._last.get(record.ring, 0.0)):
            # a start is to be quick: older ones have long been written, and told what they could
            self.scans += 1
            self._aligner.add_scan(record.ring, self._scan_of(record.content))

    def new(self, points: FacadePoints) -> FacadePoints:
        """Return those of the aligner's next points, and of its first, that no cloud has yet."""
        if len(self._held):
            points, self._held = concatenate([self._held, points]), concatenate([])
        if not self._last:
            return points
        keep, times = np.ones(len(points), dtype=bool), points.stamps_ns * 1e-9
        for ring, last in list(self._last.items()):
            own = np.flatnonzero(points.ring == ring)
            found = np.flatnonzero(times[own] == last)
            # lines of a scanner may overlap in time: what counts is the place of the last point
            keep[own[:found[-1] + 1] if len(found) else own[times[own] < last]] = False
            if times[own].max(initial=0.0) >= last:
                del self._last[ring]
        return chosen(points, keep)
