# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Writing results to a disk that may become full."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import errno
import os
from pathlib import Path
import shutil

from stri_mapping.errors import ResultsError

# Bytes that growing results leave free: summary and report, which say what is missing, follow.
ROOM = 4_000_000
# Bytes of two lines of any text file here, and more.
LONGEST_LINE = 4096


@contextmanager
def keeping(folder: Path, room: int = ROOM) -> Iterator[None]:
    """
    Turn what keeps files in a folder from being written into a ResultsError.

    Parameters
    ----------
    folder
        Existing folder.
    room
        Bytes that must be free before anything is written at all.

    """
    try:
        if room and shutil.disk_usage(folder).free < room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
        yield
    except OSError as error:
        raise ResultsError(f'{error.filename or folder}: cannot be written: {error.strerror}'
                           ) from None


def cut_to_lines(path: Path, lines: int) -> None:
    """Leave the first lines of a text file."""
    with path.open('r+b') as file:
        for _ in range(lines):
            file.readline()
        file.truncate(file.tell())


def end_whole(path: Path) -> str:
    """Cut off what is no whole line at the end of a text file; return its last line, if any."""
    with path.open('r+b') as file:
        begin = max(file.seek(0, os.SEEK_END) - LONGEST_LINE, 0)
        file.seek(begin)
        end = file.read()
        whole = end[:end.rfind(b'\n') + 1]
        file.truncate(begin + len(whole))
    return ''.join(whole.decode().splitlines()[-1:])


def whole_lines(path: Path) -> int:
    """Return how many lines of a text file have their end."""
    return path.read_bytes().count(b'\n')
