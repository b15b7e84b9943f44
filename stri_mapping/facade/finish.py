# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What is made of a finished cloud: elevations, and its quality before and after."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.cloud_files import count_points, PLY_NAME, read_ply
from stri_mapping.facade.elevation import write_elevations
from stri_mapping.facade.placing import at_constant_speed, place
from stri_mapping.facade.points import FACADE
from stri_mapping.facade.quality import measure
from stri_mapping.facade.writer import STABILISED_NAME
from stri_mapping.trajectory import read_spatial_tum, read_tum, Trajectory

Array = NDArray[np.float64]

# Pieces of a million points, half a minute of driving each, that quality is measured on.
PIECES = 8
# A drive whose ends are nearer than this share of its length is not straight enough to be
# compared with a straight drive at constant speed.
STRAIGHT = 0.7


def finish_facades(folder: Path) -> dict[str, Any]:
    """
    Write the elevations of a results folder and measure its cloud.

    Returns
    -------
    dict
        For the summary: `elevations`, see `write_elevations`, and `facade_quality`, the figures
        of `CloudQuality` by stage: `at_constant_speed`, as if the vehicle had driven straight
        at its mean speed (of straight drives only), `aligned` by the planar path, and
        `stabilised`.  Empty where there is no cloud.

    """
    if not count_points(folder / PLY_NAME):
        return {}
    path = read_tum(folder / 'trajectory.tum')
    stages: dict[str, list[dict[str, float]]] = {}
    for rows in _pieces(folder / PLY_NAME):
        for stage, xyz in _stages(folder, rows, path).items():
            stages.setdefault(stage, []).append(asdict(measure(xyz, rows['ring'])))
    return {'facade_quality': {stage: _mean(figures) for stage, figures in stages.items()},
            'elevations': write_elevations(folder, path)}


def _pieces(cloud: Path) -> Iterator[NDArray[np.void]]:
    """Iterate over the facade points of some pieces spread over the drive."""
    total = -(-count_points(cloud) // 1_000_000)
    chosen = set(np.linspace(0, total - 1, min(total, PIECES)).astype(int).tolist())
    for number, rows in enumerate(read_ply(cloud)):
        own = rows[rows['classification'] == FACADE]
        if number in chosen and len(own):
            yield own


def _stages(folder: Path, rows: NDArray[np.void], path: Trajectory) -> dict[str, Array]:
    """Return some points (n, 3) as they lie after each stage."""
    xyz = np.column_stack([rows['x'], rows['y'], rows['z']])
    # a time as a float of seconds is good to 0.2 microseconds: no ray falls off the ends
    stamps = np.clip(np.rint(rows['time'] * 1e9).astype(np.int64), path.stamps_ns[0],
                     path.stamps_ns[-1])
    found = {'stabilised': xyz}
    if (folder / STABILISED_NAME).is_file():
        base = _in_base(xyz, stamps, *read_spatial_tum(folder / STABILISED_NAME))
        xyz = place(base, path.at(stamps), np.zeros((len(xyz), 3)), np.zeros(3))
        found = {'aligned': xyz, **found}
    chord = float(np.hypot(*(path.poses[-1] - path.poses[0])[:2]))
    if chord > STRAIGHT * path.distance > 0.0:
        found = {'at_constant_speed': at_constant_speed(xyz, stamps, path), **found}
    return found


def _in_base(xyz: Array, stamps: NDArray[np.int64], pose_stamps: NDArray[np.int64],
             poses: Array) -> Array:
    """Return points of odom in base_link, by poses (m, 6) interpolated at their times."""
    seconds = (pose_stamps - pose_stamps[0]) * 1e-9
    at = np.column_stack([np.interp((stamps - pose_stamps[0]) * 1e-9, seconds, column)
                          for column in poses.T])
    x, y, z = (xyz - at[:, :3]).T
    for angle, (a, b) in ((at[:, 5], (0, 1)), (at[:, 4], (2, 0)), (at[:, 3], (1, 2))):
        cos, sin = np.cos(angle), np.sin(angle)
        p = [x, y, z]
        p[a], p[b] = cos * p[a] + sin * p[b], cos * p[b] - sin * p[a]
        x, y, z = p
    return np.column_stack([x, y, z])


def _mean(figures: list[dict[str, float]]) -> dict[str, float | None]:
    """Return the pieces' mean of every figure; None where no piece told it."""
    found: dict[str, float | None] = {}
    for name in figures[0]:
        values = np.array([f[name] for f in figures], dtype=float)
        known = values[np.isfinite(values)]
        found[name] = round(float(known.mean()), 4) if len(known) else None
    return found
