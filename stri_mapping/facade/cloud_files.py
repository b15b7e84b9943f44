# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Cloud files: a binary PLY that grows with the drive, and the LAZ made from it at the end.

In both, coordinates are metres in odom and times seconds since the Unix epoch, so that a point
can be looked up in trajectory.tum by its time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import os
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import laspy
import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement, PlyParseError

from stri_mapping import __version__
from stri_mapping.errors import StriMappingError
from stri_mapping.facade.push_broom import FacadePoints

Array = NDArray[np.float64]

PLY_NAME, LAZ_NAME = 'facade.ply', 'facade.laz'
VERTEX = np.dtype([('x', '<f8'), ('y', '<f8'), ('z', '<f8'), ('intensity', '<f4'),
                   ('time', '<f8'), ('ring', '<u2')])
# Points held in memory at a time when a file is read back.
CHUNK = 1_000_000
# Room for the digits of the point count, so that the header can be rewritten in place.
COUNT_DIGITS = 15


class CloudWriter:
    """
    Writes facade.ply as points come and facade.laz when closed; a context manager.

    The PLY is complete after every `write`: should the process die, all points written so far
    are there.  Nothing is created for a drive without points.

    Parameters
    ----------
    folder
        Existing results folder; cloud files of an earlier run are replaced.
    names
        Names of the vertical scanners by ring, noted in both files.

    """

    def __init__(self, folder: Path, names: Sequence[str] = ()) -> None:
        """Remove cloud files of an earlier run; nothing is opened yet."""
        self.folder = folder
        self.names = tuple(names)
        self.count = 0
        self._file: BinaryIO | None = None
        self._bounds = np.array([np.full(3, np.inf), np.full(3, -np.inf)])
        self._brightest = 0.0
        for name in (PLY_NAME, LAZ_NAME):
            (folder / name).unlink(missing_ok=True)

    def __enter__(self) -> CloudWriter:
        """Return the writer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close both files, whatever happened."""
        self.close()

    def write(self, points: FacadePoints) -> None:
        """Append points to facade.ply."""
        if not len(points):
            return
        rows = np.empty(len(points), VERTEX)
        rows['x'], rows['y'], rows['z'] = points.xyz.T
        rows['intensity'], rows['ring'] = points.intensity, points.ring
        rows['time'] = points.stamps_ns * 1e-9
        if self._file is None:
            self._file = (self.folder / PLY_NAME).open('wb')
            self._file.write(_ply_header(0, self.names))
        self._file.write(rows.data)
        self.count += len(points)
        self._bounds = np.array([np.minimum(self._bounds[0], points.xyz.min(axis=0)),
                                 np.maximum(self._bounds[1], points.xyz.max(axis=0))])
        self._brightest = max(self._brightest, float(points.intensity.max()))
        self._write_count(self._file)

    def _write_count(self, file: BinaryIO) -> None:
        """Put the count into the header, after the points it counts are with the system."""
        file.flush()
        file.seek(0)
        file.write(_ply_header(self.count, self.names))
        file.seek(0, os.SEEK_END)
        file.flush()

    def close(self) -> None:
        """Finish facade.ply and make facade.laz of it; a second call does nothing."""
        if self._file is None:
            return
        self._file.close()
        self._file = None
        # devices of 8 bits give up to 255; LAS wants intensity spread over all 16 bits
        scale = 257.0 if self._brightest <= 255.0 else 1.0
        _write_laz(self.folder, self._bounds[0], scale, self.names)


def _ply_header(count: int, names: Sequence[str]) -> bytes:
    """Return a PLY header whose length does not depend on the count."""
    comments = [f'stri_mapping {__version__}', 'x y z metres in odom, time seconds since 1970',
                *(f'ring {ring} {name}' for ring, name in enumerate(names)),
                'padding ' + '.' * (COUNT_DIGITS - len(str(count)))]
    vertex = PlyElement.describe(np.empty(0, VERTEX), 'vertex')
    header = str(PlyData([vertex], byte_order='<', comments=comments).header)
    return (header.replace('element vertex 0', f'element vertex {count}') + '\n').encode('ascii')


def _write_laz(folder: Path, lowest: Array, scale: float, names: Sequence[str]) -> None:
    """Write facade.laz from facade.ply; it takes its name when complete."""
    header = laspy.LasHeader(version='1.4', point_format=6)
    header.scales, header.offsets = np.full(3, 0.001), np.floor(lowest)
    header.global_encoding.wkt = True       # LAS 1.4 asks it of point formats 6 and above
    header.generating_software = f'stri_mapping {__version__}'
    header.system_identifier = 'line scanners'
    header.vlrs.append(laspy.VLR('LASF_Spec', 3, 'Text Area Description',
                                 _description(scale, names).encode()))
    part = folder / (LAZ_NAME + '.part')
    with laspy.open(part, mode='w', header=header, do_compress=True) as writer:
        for rows in read_ply(folder / PLY_NAME):
            writer.write_points(_las_points(rows, header, scale))
    os.replace(part, folder / LAZ_NAME)


def _description(scale: float, names: Sequence[str]) -> str:
    sources = ', '.join(f'{ring + 1} {name}' for ring, name in enumerate(names))
    return ('x y z: metres in the frame odom. gps_time: seconds since the Unix epoch, as in '
            f'trajectory.tum. intensity: device units times {scale:.0f}. '
            f'point_source_id: scanner, ring + 1{": " if sources else ""}{sources}.')


def _las_points(
    rows: NDArray[np.void], header: laspy.LasHeader, scale: float,
) -> laspy.ScaleAwarePointRecord:
    points = laspy.ScaleAwarePointRecord.zeros(len(rows), header=header)
    points.x, points.y, points.z = rows['x'], rows['y'], rows['z']
    points.intensity = np.clip(np.rint(rows['intensity'] * scale), 0, 65535).astype(np.uint16)
    points.gps_time = rows['time']
    points.point_source_id = rows['ring'] + np.uint16(1)    # LAS keeps 0 for "this file"
    points.return_number[:] = points.number_of_returns[:] = 1
    return points


def read_ply(path: Path, every: int = 1) -> Iterator[NDArray[np.void]]:
    """
    Iterate over a facade.ply in pieces of at most a million points.

    Parameters
    ----------
    path
        The file, as `CloudWriter` makes it.
    every
        Take one point in so many.

    Yields
    ------
    NDArray
        Records with the fields x, y, z, intensity, time and ring, see `VERTEX`.

    Raises
    ------
    StriMappingError
        If the file is not such a cloud.

    """
    rows = _vertices(path)
    step = CHUNK * every
    for first in range(0, len(rows), step):
        yield np.array(rows[first:first + step:every])


def count_points(path: Path) -> int:
    """Return how many points a facade.ply holds; 0 where there is no file."""
    return len(_vertices(path)) if path.is_file() else 0


def _vertices(path: Path) -> NDArray[np.void]:
    """Return the points of a facade.ply as records, mapped into memory."""
    try:
        rows: NDArray[np.void] = PlyData.read(path, mmap='r')['vertex'].data
        if rows.dtype.names != VERTEX.names:
            raise KeyError(f'fields {rows.dtype.names}, want {VERTEX.names}')
        return rows
    except (OSError, PlyParseError, KeyError, ValueError) as error:
        raise StriMappingError(f'{path}: not a cloud of stri_mapping: {error}') from None
