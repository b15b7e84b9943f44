# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Step 1 of the paper: the spatio-temporal range image, scans stacked along time.

Rows are scans, columns rays.  `RangeImage` is the sliding window that the estimator and the
live pictures use; `RangeImageLog` keeps a thinned image of a whole drive for the report.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stri_mapping.scan import Scan
from stri_mapping.stri.segmentation import Labels, UNLABELLED

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

# Twelve colours of equal lightness that stay apart for most eyes (after Okabe & Ito).
PALETTE = np.array([
    [0, 114, 178], [230, 159, 0], [0, 158, 115], [204, 121, 167], [86, 180, 233], [213, 94, 0],
    [240, 228, 66], [117, 112, 179], [102, 166, 30], [231, 41, 138], [166, 118, 29],
    [27, 158, 119]], dtype=np.uint8)


class RangeImage:
    """
    The newest scans, oldest row first.

    Parameters
    ----------
    seconds
        Length of the window by the scans' stamps.

    """

    def __init__(self, seconds: float) -> None:
        """Start empty."""
        self.seconds = seconds
        self._rows: list[tuple[Scan, Labels]] = []

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._rows)

    def append(self, scan: Scan, labels: Labels) -> None:
        """Add a row, and drop those that have left the window."""
        self._rows.append((scan, labels))
        oldest = scan.stamp_ns - round(1e9 * self.seconds)
        while self._rows[0][0].stamp_ns < oldest:
            self._rows.pop(0)

    def ranges(self) -> Array:
        """Return the image (rows, rays) in metres, NaN where there is no return or no ray."""
        width = max((len(s) for s, _ in self._rows), default=0)
        image = np.full((len(self._rows), width), np.nan)
        for row, (scan, _) in zip(image, self._rows):
            row[:len(scan)] = np.where(scan.valid, scan.ranges, np.nan)
        return image

    def labels(self) -> Labels:
        """Return the surface number of every pixel (rows, rays), `UNLABELLED` for none."""
        width = max((len(s) for s, _ in self._rows), default=0)
        image = np.full((len(self._rows), width), UNLABELLED, dtype=np.int32)
        for row, (scan, labels) in zip(image, self._rows):
            row[:len(scan)] = labels
        return image

    def picture(self, far: float = 30.0) -> Picture:
        """Return the image in grey (rows, rays), near bright, no return black."""
        return grey(self.ranges(), far)

    def segment_picture(self) -> Picture:
        """Return the surfaces in colour (rows, rays, 3), grey where there is none."""
        return coloured(self.labels())


def grey(ranges: Array, far: float = 30.0) -> Picture:
    """Return ranges in metres as grey levels: 255 at 0 m, 40 at `far` and beyond, 0 for NaN."""
    level = 255.0 - 215.0 * np.clip(np.nan_to_num(ranges) / far, 0.0, 1.0)
    return np.where(np.isfinite(ranges), level, 0.0).astype(np.uint8)


def coloured(labels: Labels) -> Picture:
    """Return labels as colours (..., 3); `UNLABELLED` is dark grey."""
    picture = PALETTE[labels % len(PALETTE)]
    picture[labels == UNLABELLED] = 40
    return picture


class RangeImageLog:
    """
    Image of a whole drive in bounded memory: when full, every second row is dropped.

    Parameters
    ----------
    capacity
        Rows kept at most.

    """

    def __init__(self, capacity: int = 3000) -> None:
        """Start empty, taking every scan."""
        self.capacity = capacity
        self._stride = 1
        self._seen = 0
        self._rows: list[tuple[Scan, Labels]] = []

    def append(self, scan: Scan, labels: Labels) -> None:
        """Offer a scan with its labels."""
        if self._seen % self._stride == 0:
            self._rows.append((scan, labels))
            if len(self._rows) > self.capacity:
                self._rows = self._rows[::2]
                self._stride *= 2
        self._seen += 1

    def save(self, path: Path) -> None:
        """
        Write stamps_ns (m,), bearings (k,), ranges (m, k), segments (m, k) as a .npz file.

        Bearings are those of the widest scan, in the scanner frame in radians; ranges are NaN
        where there is no return; interlaced scans of other rasters share its columns.

        """
        window = RangeImage(np.inf)
        window._rows = self._rows
        widest = max((s for s, _ in self._rows), key=len, default=None)
        np.savez_compressed(
            path, stamps_ns=np.array([s.stamp_ns for s, _ in self._rows], dtype=np.int64),
            bearings=np.zeros(0) if widest is None else widest.angles,
            ranges=window.ranges().astype(np.float32), segments=window.labels())
