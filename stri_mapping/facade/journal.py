# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
What the aligner took in lately, on disk for the one that takes over when its process is killed.

Points come seconds after their scans, which wait in memory meanwhile.  What write(2) has taken
outlives the process, so that nothing has to be forced onto the disk.
"""

from __future__ import annotations

from dataclasses import astuple, fields
import errno
from io import FileIO
import logging
import os
from pathlib import Path
import struct
from typing import NamedTuple
import zlib

import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.push_broom import AlignerCounts

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
logger = logging.getLogger(__name__)

# The newer file and the older one.
JOURNAL_NAMES = ('facade_journal', 'facade_journal_before')
# Before each record's content: its length, its checksum, its kind, the ring of a scan, and the
# stamp of the scan or of the last pose.
HEAD = struct.Struct('<IIBBq')
SCAN, POSES, COUNTS = range(3)
COUNTS_FORM = struct.Struct(f'<{len(fields(AlignerCounts))}q')
# Kept at least of what came before all that waits, nanoseconds: what the next lines are
# compared with, walls that another scanner saw and the facade of the last 60 lines.
KEPT_NS = 2_000_000_000


class Record(NamedTuple):
    """One thing that came or was done: kind, ring of a scan, newest stamp in it, and bytes."""

    kind: int
    ring: int
    stamp_ns: int
    content: bytes


class Journal:
    """
    Two files that hold the last seconds of scans and poses, in the order in which they came.

    Whoever reads them back finds every record that was added before the process was killed; one
    that was being written is left out.  Where the disk takes no more, that is said once, the
    files are removed, and nothing is kept any more.

    Parameters
    ----------
    folder
        Existing results folder; None to keep nothing.
    resume
        Go on with the files that are there, as after a crash, instead of removing them.

    """

    def __init__(self, folder: Path | None, resume: bool = False) -> None:
        """Begin the newer file, or open it behind its last whole record."""
        self._newer, self._older = ((folder or Path()) / name for name in JOURNAL_NAMES)
        self._file: FileIO | None = None
        self._newest_ns = 0                      # of all scans
        self._begun_ns: int | None = None        # newest scan before those in the newer file
        if folder is None:
            return
        try:
            if not resume:
                self._remove()
            elif self._newer.is_file():
                _, end = whole_records(self._newer.read_bytes())
                os.truncate(self._newer, end)
            self._file = FileIO(self._newer, 'a')
        except OSError as error:
            self._give_up(error)

    def read_back(self) -> list[Record]:
        """Return what is kept, oldest first."""
        if self._file is None:
            return []
        found = [path.read_bytes() for path in (self._older, self._newer) if path.is_file()]
        return [record for data in found for record in whole_records(data)[0]]

    def add_scan(self, ring: int, stamp_ns: int, message: bytes) -> None:
        """Keep a scan of one scanner: its serialised message."""
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if self._begun_ns is None:
            self._begun_ns = stamp_ns
        self._add(SCAN, ring, stamp_ns, message)

    def add_poses(self, stamps_ns: Stamps, poses: Array) -> None:
        """Keep planar poses (n, 3) with their stamps (n,), at least one."""
        self._add(POSES, 0, int(stamps_ns[-1]),
                  stamps_ns.astype('<i8').tobytes() + poses.astype('<f8').tobytes())

    def add_counts(self, counts: AlignerCounts) -> None:
        """Keep what became of the rays of all that was added before."""
        self._add(COUNTS, 0, 0, COUNTS_FORM.pack(*astuple(counts)))

    def forget(self, done_ns: int) -> None:
        """Drop the older file if all in it is long before a time whose points are written."""
        if (self._file is None or self._begun_ns is None
                or done_ns < self._begun_ns + KEPT_NS):
            return
        try:
            self._file.close()
            self._newer.replace(self._older)
            self._file, self._begun_ns = FileIO(self._newer, 'a'), self._newest_ns
        except OSError as error:
            self._give_up(error)

    def close(self) -> None:
        """Keep nothing any more: no crash will follow.  A second call does nothing."""
        if self._file is not None:
            self._file.close()
            self._file = None
            self._remove()

    def _add(self, kind: int, ring: int, stamp_ns: int, content: bytes) -> None:
        if self._file is None:
            return
        record = HEAD.pack(len(content), zlib.crc32(content), kind, ring, stamp_ns) + content
        try:
            if self._file.write(record) != len(record):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        logger.warning('%s: cannot be written: %s; the drive goes on, but should the aligner be '
                       'killed, scans that wait for their poses are lost', self._newer,
                       error.strerror)
        if self._file is not None:
            self._file.close()
            self._file = None
        try:
            self._remove()
        except OSError:             # a folder that is gone, or may not be changed any more
            pass

    def _remove(self) -> None:
        self._newer.unlink(missing_ok=True)
        self._older.unlink(missing_ok=True)


def whole_records(data: bytes) -> tuple[list[Record], int]:
    """Return the records of a file up to the first that is not whole, and where they end."""
    found, at = [], 0
    while at + HEAD.size <= len(data):
        size, checksum, kind, ring, stamp = HEAD.unpack_from(data, at)
        content = data[at + HEAD.size:at + HEAD.size + size]
        if len(content) < size or zlib.crc32(content) != checksum:
            break
        found.append(Record(kind, ring, stamp, content))
        at += HEAD.size + size
    return found, at


def poses_of(record: Record) -> tuple[Stamps, Array]:
    """Return the stamps (n,) and planar poses (n, 3) of a record of that kind."""
    count = len(record.content) // 32            # four numbers of 8 bytes each
    return (np.frombuffer(record.content, '<i8', count).astype(np.int64),
            np.frombuffer(record.content, '<f8', offset=8 * count).reshape(-1, 3).astype(float))


def counts_of(record: Record) -> AlignerCounts:
    """Return what became of the rays, of a record of that kind."""
    return AlignerCounts(*COUNTS_FORM.unpack(record.content))
