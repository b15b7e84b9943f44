# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""LAZ files of facades: LAS 1.4, point format 6, compressed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import os
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray

from stri_mapping import __version__
from stri_mapping.facade.points import CLASS_NAMES

LAZ_NAME = 'facade.laz'
# Points in a file: under 200 MB even at 9 bytes a point, twice what is usual.
TILE = 20_000_000

Pieces = Callable[[], Iterator[NDArray[np.void]]]


def write_laz(path: Path, pieces: Pieces, names: Sequence[str], tile: int = TILE) -> None:
    """
    Write facade points as LAZ; each file takes its name when complete.

    Parameters
    ----------
    path
        First file; `facade_2.laz` and so on follow where it is full.
    pieces
        Gives all points anew, as records with the fields of `cloud_files.VERTEX`.
    names
        Names of the scanners by ring.
    tile
        Points after which a file is full.

    """
    lowest, brightest = np.full(3, np.inf), 0.0
    for rows in pieces():
        for axis, name in enumerate('xyz'):
            lowest[axis] = min(lowest[axis], float(rows[name].min()))
        brightest = max(brightest, float(rows['intensity'].max()))
    # devices of 8 bits give up to 255; LAS wants intensity spread over all 16 bits
    scale = 257.0 if brightest <= 255.0 else 1.0
    number, room = 0, 0
    writer: laspy.LasWriter | None = None
    for rows in pieces():
        while len(rows):
            if writer is None or room == 0:
                _close(writer, path, number)
                number, room = number + 1, tile
                header = _header(np.floor(lowest), scale, names)
                writer = laspy.open(_part(path, number), mode='w', header=header,
                                    do_compress=True)
            writer.write_points(_las_points(rows[:room], header, scale))
            rows, room = rows[room:], max(room - len(rows), 0)
    _close(writer, path, number)


def _numbered(path: Path, number: int) -> Path:
    return path if number == 1 else path.with_stem(f'{path.stem}_{number}')


def _part(path: Path, number: int) -> Path:
    whole = _numbered(path, number)
    return whole.with_name(whole.name + '.part')


def _close(writer: laspy.LasWriter | None, path: Path, number: int) -> None:
    if writer is not None:
        writer.close()
        os.replace(_part(path, number), _numbered(path, number))


def _header(offsets: NDArray[np.float64], scale: float, names: Sequence[str]) -> laspy.LasHeader:
    header = laspy.LasHeader(version='1.4', point_format=6)
    header.scales, header.offsets = np.full(3, 0.001), offsets
    header.global_encoding.wkt = True       # LAS 1.4 asks it of point formats 6 and above
    header.generating_software = f'stri_mapping {__version__}'
    header.system_identifier = 'line scanners'
    header.vlrs.append(laspy.VLR('LASF_Spec', 3, 'Text Area Description',
                                 _description(scale, names).encode()))
    return header


def _description(scale: float, names: Sequence[str]) -> str:
    sources = ', '.join(f'{ring + 1} {name}' for ring, name in enumerate(names))
    classes = ', '.join(f'{code} {name}' for code, name in CLASS_NAMES.items())
    return ('x y z: metres in the frame odom. gps_time: seconds since the Unix epoch, as in '
            f'trajectory.tum. intensity: device units times {scale:.0f}. classification: '
            f'{classes}. point_source_id: scanner, ring + 1{": " if sources else ""}{sources}.')


def _las_points(
    rows: NDArray[np.void], header: laspy.LasHeader, scale: float,
) -> laspy.ScaleAwarePointRecord:
    points = laspy.ScaleAwarePointRecord.zeros(len(rows), header=header)
    points.x, points.y, points.z = rows['x'], rows['y'], rows['z']
    points.intensity = np.clip(np.rint(rows['intensity'] * scale), 0, 65535).astype(np.uint16)
    points.gps_time, points.classification = rows['time'], rows['classification']
    points.point_source_id = rows['ring'] + np.uint16(1)    # LAS keeps 0 for "this file"
    points.return_number[:] = points.number_of_returns[:] = 1
    return points
