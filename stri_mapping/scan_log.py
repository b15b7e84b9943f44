# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What came on a scanner's topic, kept on disk for a node that takes over after a crash."""

from __future__ import annotations

from array import array
import os
from pathlib import Path
import struct

from stri_mapping.scan import ScanCounts

# The counts; the stamps follow as 8 bytes each.
HEADER = struct.Struct('<4q')
NAME = 'scans_{}.log'


class ScanLog:
    """
    Counts and stamps of one scanner's scans, in memory and on disk.

    Parameters
    ----------
    path
        File to keep them in, None for none.
    resume
        Go on with what is kept there.

    Attributes
    ----------
    counts
        What was met.
    stamps
        Of the good scans, nanoseconds.

    """

    def __init__(self, path: Path | None = None, resume: bool = False) -> None:
        """Read back what is kept, where that is wanted."""
        self.counts, self.stamps = ScanCounts(), array('q')
        self._path, self._file = path, -1
        if path is None:
            return
        if resume and path.is_file():
            self._read_back(path.read_bytes())
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)
            self._write(self.stamps.tobytes(), 0)
        except OSError:                 # a full disk: only what is said after a crash lacks it
            pass

    def _read_back(self, data: bytes) -> None:
        if len(data) >= HEADER.size:
            self.counts = ScanCounts(*HEADER.unpack_from(data))
            end = len(data) - (len(data) - HEADER.size) % self.stamps.itemsize
            self.stamps.frombytes(data[HEADER.size:end])

    def note(self, stamp_ns: int | None) -> None:
        """Keep that the counts have changed, by a good scan where a stamp is given."""
        first = len(self.stamps)
        if stamp_ns is not None:
            self.stamps.append(stamp_ns)
        try:
            self._write(self.stamps[first:].tobytes(), first)
        except OSError:
            self.close()

    def _write(self, stamps: bytes, first: int) -> None:
        if self._file >= 0:
            os.pwrite(self._file, stamps, HEADER.size + first * self.stamps.itemsize)
            os.pwrite(self._file, HEADER.pack(*vars(self.counts).values()), 0)

    def close(self) -> None:
        """Keep nothing on disk any more: no crash will follow."""
        if self._file >= 0 and self._path is not None:
            os.close(self._file)
            self._file = -1
            self._path.unlink(missing_ok=True)
