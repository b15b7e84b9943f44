# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""LAZ files of facades: LAS 1.4, point format 6, compressed."""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray

from stri_mapping import __version__
from stri_mapping.facade.points import CLASS_NAMES

LAZ_NAME = 'facade.laz'
# Points compressed at a time: some 30 ms, for which other threads have to wait.
CHUNK = 50_000


def write_laz(path: Path, rows: NDArray[np.void], names: Sequence[str],
              brightest: float) -> None:
    """
    Write facade points as LAZ; the file takes its name when complete.

    Parameters
    ----------
    path
        The file.
    rows
        (n,) records with the fields of `cloud_files.VERTEX`, n > 0; may be mapped from a file.
    names
        Names of the scanners by ring.
    brightest
        The scanners' highest intensity so far.  Devices of 8 bits give up to 255; LAS wants
        intensity spread over all 16 bits.

    """
    lowest = np.array([np.floor(np.min(rows[axis])) for axis in 'xyz'])
    scale = 257.0 if brightest <= 255.0 else 1.0
    header, part = _header(lowest, scale, names), path.with_name(path.name + '.part')
    with laspy.open(part, mode='w', header=header, do_compress=True) as writer:
        for first in range(0, len(rows), CHUNK):
            writer.write_points(_las_points(np.array(rows[first:first + CHUNK]), header, scale))
    os.replace(part, path)


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
