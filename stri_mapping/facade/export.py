# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds in further formats, on request: PCD (PCL, Open3D) and E57 (surveyors' programs)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stri_mapping.errors import UsageError
from stri_mapping.facade.cloud_files import PLY_NAME, read_ply, tile_path, tiles

# Each with the package that writes it.
FORMATS = {'pcd': 'pypcd4', 'e57': 'pye57'}


def require(kind: str) -> None:
    """Raise UsageError, with the line that installs it, unless a format can be written."""
    try:
        __import__(FORMATS[kind])
    except ImportError:
        raise UsageError(f'--{kind} needs the package {FORMATS[kind]}: '
                         f"pip install 'stri_mapping[{kind}]'") from None


def export(folder: Path, kind: str) -> list[Path]:
    """
    Write facade.ply in another format beside it, file by file.

    Parameters
    ----------
    folder
        Results folder.
    kind
        'pcd': binary, with the fields of the PLY; x y z are float32, the only ones PCL takes.
        'e57': x y z and intensity, one scan (data3D) for each scanner, named ring_0 and so on.

    Returns
    -------
    list
        The files, none where there is no cloud.

    Raises
    ------
    UsageError
        If the package that writes it is missing.

    """
    require(kind)
    write: Callable[[Path, NDArray[np.void]], None] = {'pcd': _pcd, 'e57': _e57}[kind]
    found = []
    for number, tile in enumerate(tiles(folder / PLY_NAME), start=1):
        path = tile_path(folder / f'facade.{kind}', number)
        path.unlink(missing_ok=True)
        write(path, np.concatenate(list(read_ply(tile))))
        found.append(path)
    return found


def _pcd(path: Path, rows: NDArray[np.void]) -> None:
    from pypcd4.pypcd4 import PointCloud
    fields = ('x', 'y', 'z', 'intensity', 'time', 'ring', 'classification')
    types = (np.float32, np.float32, np.float32, np.float32, np.float64, np.uint16, np.uint8)
    PointCloud.from_points([rows[name] for name in fields], fields, types).save(path)


def _e57(path: Path, rows: NDArray[np.void]) -> None:
    import pye57
    file = pye57.E57(str(path), mode='w')
    try:
        for ring in np.unique(rows['ring']):
            own = rows[rows['ring'] == ring]
            data = {f'cartesian{axis.upper()}': np.array(own[axis]) for axis in 'xyz'}
            file.write_scan_raw({**data, 'intensity': np.array(own['intensity'])},
                                name=f'ring_{ring}')
    finally:
        file.close()
