# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Cloud files: binary PLY that grows with the drive, in tiles of under 200 MB, and a LAZ of each.

Coordinates are metres in odom and times seconds since the Unix epoch, so that a point can be
looked up in trajectory.tum by its time.  facade.ply is followed by facade_2.ply and so on once
it is full; the functions here that read take the first and mean all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import count
import os
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement, PlyParseError

from stri_mapping import __version__
from stri_mapping.errors import StriMappingError
from stri_mapping.facade.las_file import LAZ_NAME, write_laz
from stri_mapping.facade.points import CLASS_NAMES, FacadePoints

Array = NDArray[np.float64]

PLY_NAME = 'facade.ply'
VERTEX = np.dtype([('x', '<f8'), ('y', '<f8'), ('z', '<f8'), ('intensity', '<f4'),
                   ('time', '<f8'), ('ring', '<u2'), ('classification', 'u1')])
# Points in a tile: 195 MB.
TILE = 5_000_000
# Points held in memory at a time when a file is read back.
CHUNK = 1_000_000
# A cloud is searched by the time of one point in so many, seconds of slack aside.
BLOCK, SLACK = 4096, 1.0
# Points looked at in one go where the newest are looked for: seconds of them.
PART = 100_000
# Room for the digits of the point count, so that the header can be rewritten in place.
COUNT_DIGITS = 15


class CloudWriter:
    """
    Writes facade.ply as points come, and facade.laz tile by tile; a context manager.

    The PLY is complete after every `write`: should the process die, all points written so far
    are there.  A tile that is full is compressed in a thread of its own while the next one grows,
    the last one by `close`.  Nothing is created for a drive without points.

    Parameters
    ----------
    folder
        Existing results folder; cloud files of an earlier run are replaced.
    names
        Names of the vertical scanners by ring, noted in all files.
    tile
        Points after which a file is full.
    append
        Go on with the cloud that is there, as after a crash, instead of replacing it.

    """

    def __init__(self, folder: Path, names: Sequence[str] = (), tile: int = TILE,
                 append: bool = False) -> None:
        """Remove cloud files of an earlier run, or open the last of them."""
        self.folder = folder
        self.names = tuple(names)
        self.count = 0
        self._tile = tile
        self._file: BinaryIO | None = None
        self._in_file = 0
        self._closed = False
        self._brightest = 0.0
        self._compressor = ThreadPoolExecutor(max_workers=1)
        self._compressed: list[Future[None]] = []
        for name in () if append else (PLY_NAME, LAZ_NAME):
            for path in tiles(folder / name):
                path.unlink()
        if tiles(folder / PLY_NAME):
            self._take_up(tiles(folder / PLY_NAME))

    def __enter__(self) -> CloudWriter:
        """Return the writer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close all files, whatever happened."""
        self.close()

    def write(self, points: FacadePoints) -> None:
        """Append points to the newest tile, and begin the next where it is full."""
        rows = np.empty(len(points), VERTEX)
        rows['x'], rows['y'], rows['z'] = points.xyz.T
        rows['intensity'], rows['ring'] = points.intensity, points.ring
        rows['time'], rows['classification'] = points.stamps_ns * 1e-9, points.label
        self._brightest = max(self._brightest, float(points.intensity.max(initial=0.0)))
        while len(rows):
            if self._file is None or self._in_file >= self._tile:
                self._next_file()
            room = self._tile - self._in_file
            self._append(rows[:room])
            rows = rows[room:]

    def _take_up(self, found: Sequence[Path]) -> None:
        """Open the last of a cloud's files behind the points that its header counts."""
        sizes = [len(_vertices(path)) for path in found]
        self.count, self._in_file = sum(sizes), sizes[-1]
        self._brightest = float(_vertices(found[-1])['intensity'].max(initial=0.0))
        tile_path(self.folder / LAZ_NAME, len(found)).unlink(missing_ok=True)
        for number in range(1, len(found)):
            if not tile_path(self.folder / LAZ_NAME, number).is_file():
                self._compress(number)
        self._file = found[-1].open('r+b')
        self._file.truncate(len(_ply_header(0, self.names)) + sizes[-1] * VERTEX.itemsize)
        self._file.seek(0, os.SEEK_END)

    def _next_file(self) -> None:
        number = len(tiles(self.folder / PLY_NAME)) + 1
        if self._file is not None:
            self._file.close()
            self._compress(number - 1)
        self._file, self._in_file = tile_path(self.folder / PLY_NAME, number).open('wb'), 0
        self._file.write(_ply_header(0, self.names))

    def _compress(self, number: int) -> None:
        """Have a finished tile written as LAZ; numbers begin at 1."""
        rows = _vertices(tile_path(self.folder / PLY_NAME, number))
        self._compressed.append(self._compressor.submit(
            write_laz, tile_path(self.folder / LAZ_NAME, number), rows, self.names,
            self._brightest))

    def _append(self, rows: NDArray[np.void]) -> None:
        """Write rows, and then their count into the header."""
        assert self._file is not None
        self._file.write(rows.tobytes())
        self._in_file += len(rows)
        self.count += len(rows)
        self._file.flush()
        self._file.seek(0)
        self._file.write(_ply_header(self._in_file, self.names))
        self._file.seek(0, os.SEEK_END)
        self._file.flush()

    def close(self) -> None:
        """Finish the last PLY and all LAZ; a second call does nothing."""
        if self._file is None or self._closed:
            return
        self._closed = True
        self._file.close()
        if self._in_file:
            self._compress(len(tiles(self.folder / PLY_NAME)))
        self._compressor.shutdown()
        for each in self._compressed:
            each.result()                        # raises what went wrong


def tile_path(path: Path, number: int) -> Path:
    """Return the file of a tile, numbered from 1, of a cloud whose first file is given."""
    return path if number == 1 else path.with_stem(f'{path.stem}_{number}')


def tiles(path: Path) -> list[Path]:
    """Return the files there are of a cloud whose first file is given."""
    found: list[Path] = []
    for number in count(1):
        tile = tile_path(path, number)
        if not tile.is_file():
            return found
        found.append(tile)
    raise AssertionError


def _ply_header(points: int, names: Sequence[str]) -> bytes:
    """Return a PLY header whose length does not depend on the count."""
    classes = ', '.join(f'{code} {name}' for code, name in CLASS_NAMES.items())
    comments = [f'stri_mapping {__version__}', 'x y z metres in odom, time seconds since 1970',
                f'classification {classes}',
                *(f'ring {ring} {name}' for ring, name in enumerate(names)),
                'padding ' + '.' * (COUNT_DIGITS - len(str(points)))]
    vertex = PlyElement.describe(np.empty(0, VERTEX), 'vertex')
    header = str(PlyData([vertex], byte_order='<', comments=comments).header)
    return (header.replace('element vertex 0', f'element vertex {points}') + '\n').encode('ascii')


def read_ply(path: Path, every: int = 1) -> Iterator[NDArray[np.void]]:
    """
    Iterate over a cloud in pieces of at most a million points.

    Parameters
    ----------
    path
        Its first file, as `CloudWriter` makes it.
    every
        Take one point in so many.

    Yields
    ------
    NDArray
        Records with the fields of `VERTEX`.

    Raises
    ------
    StriMappingError
        If a file is not such a cloud.

    """
    step = CHUNK * every
    for tile in tiles(path) or [path]:
        rows = _vertices(tile)
        for first in range(0, len(rows), step):
            yield np.array(rows[first:first + step:every])


def read_between(path: Path, begin: float, end: float) -> NDArray[np.void]:
    """
    Return the points of a cloud whose rays were sent between two times.

    Parameters
    ----------
    path
        Its first file.
    begin, end
        Seconds since the epoch.

    """
    pieces = [np.empty(0, VERTEX)]
    for tile in tiles(path):
        rows = _vertices(tile)
        # scan lines follow each other by their stamps: times run on but for a line's length
        blocks = np.array(rows['time'][::BLOCK])
        first = max(int(np.searchsorted(blocks, begin - SLACK)) - 1, 0)
        part = rows[first * BLOCK:int(np.searchsorted(blocks, end + SLACK)) * BLOCK]
        pieces.append(np.array(part[(begin <= part['time']) & (part['time'] <= end)]))
    return np.concatenate(pieces)


def last_times(path: Path, since: float) -> dict[int, float]:
    """
    Return by ring the time of the last point of each scanner, as it is in the file.

    Parameters
    ----------
    path
        Its first file, which need not be there.
    since
        Seconds since the epoch: scanners whose last point is older may be left out.

    """
    found: dict[int, float] = {}
    for tile in reversed(tiles(path)):
        rows = _vertices(tile)
        for stop in range(len(rows), 0, -PART):
            part = np.array(rows[max(stop - PART, 0):stop])
            for ring in np.unique(part['ring']).tolist():
                found.setdefault(ring, float(part['time'][part['ring'] == ring][-1]))
            if part['time'].max() < since:
                return found
    return found


def count_points(path: Path) -> int:
    """Return how many points a cloud holds; 0 where there is no file."""
    return sum(len(_vertices(tile)) for tile in tiles(path))


def _vertices(path: Path) -> NDArray[np.void]:
    """Return the points of one file as records, mapped into memory."""
    try:
        rows: NDArray[np.void] = PlyData.read(path, mmap='r')['vertex'].data
        if rows.dtype.names != VERTEX.names:
            raise KeyError(f'fields {rows.dtype.names}, want {VERTEX.names}')
        return rows
    except (OSError, PlyParseError, KeyError, ValueError) as error:
        raise StriMappingError(f'{path}: not a cloud of stri_mapping: {error}') from None
