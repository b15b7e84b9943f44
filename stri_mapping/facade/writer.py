# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the aligner leaves in a results folder, the same for `map` and for the live node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, fields
from pathlib import Path
import struct
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from stri_mapping.disk import cut_to_lines, keeping, whole_lines
from stri_mapping.facade.cloud_files import CloudWriter
from stri_mapping.facade.points import FacadePoints
from stri_mapping.facade.push_broom import AlignerCounts, FacadeAligner
from stri_mapping.trajectory import read_tum, spatial_tum_line

Stamps = NDArray[np.int64]
Array = NDArray[np.float64]
# What became of the rays, while the drive goes on.
COUNTS_NAME, COUNTS = 'facade_counts', struct.Struct(f'<{len(fields(AlignerCounts))}q')
STABILISED_NAME = 'trajectory_stabilised.tum'


class FacadeWriter:
    """
    Takes points and poses from an aligner into facade.ply and trajectory_stabilised.tum.

    Parameters
    ----------
    folder
        Existing results folder; its facade files of an earlier run are replaced.
    names
        Names of the vertical scanners by ring; with none there is nothing to write.
    append
        Go on with the files that are there, as after a crash, instead of replacing them.

    """

    def __init__(self, folder: Path, names: Sequence[str], append: bool = False) -> None:
        """Begin the files, or open them."""
        self._folder, self._counts = folder, folder / COUNTS_NAME
        self._cloud = CloudWriter(folder, names, append=append)
        self._poses: TextIO | None = None
        self._written_ns = -1                    # newest pose in the file
        path = folder / STABILISED_NAME
        if append and path.is_file():
            self._written_ns = int(read_tum(path).stamps_ns.max(initial=-1))
        if names:
            self._poses = path.open('a' if append else 'w', encoding='utf-8')
        elif not append:
            path.unlink(missing_ok=True)

    def take(self, aligner: FacadeAligner) -> FacadePoints:
        """Write what became final in the aligner; return the points."""
        points = aligner.take_points()
        self.write(points, *aligner.take_poses())
        return points

    def write(self, points: FacadePoints, stamps: Stamps, poses: Array,
              counts: AlignerCounts | None = None) -> None:
        """
        Write points, poses (n, 6) with their stamps (n,), and what became of the rays so far.

        The counts are for `kept_counts` of a writer that takes over after a crash.

        Raises
        ------
        ResultsError
            If the disk does not take them.

        """
        with keeping(self._folder):
            self._cloud.write(points)
            if self._poses is not None:
                new = stamps > self._written_ns      # after a crash the path comes whole again
                for stamp, pose in zip(stamps[new].tolist(), poses[new]):
                    self._poses.write(spatial_tum_line(stamp, pose) + '\n')
                self._poses.flush()
            if counts is not None:
                self._counts.write_bytes(COUNTS.pack(*astuple(counts)))

    def kept_counts(self) -> AlignerCounts:
        """Return what became of the rays before a crash; zeros where that is not known."""
        if not self._counts.is_file() or self._counts.stat().st_size != COUNTS.size:
            return AlignerCounts()
        return AlignerCounts(*COUNTS.unpack(self._counts.read_bytes()))

    def close(self) -> None:
        """Finish all files; a second call does nothing."""
        self._counts.unlink(missing_ok=True)
        with keeping(self._folder, room=0):
            if self._poses is not None:
                self._poses.close()
            self._cloud.close()

    def abandon(self) -> None:
        """Close all files with what is whole in them, when no more can be written."""
        for file in (self._poses, self._cloud):
            try:
                if file is not None:
                    file.close()
            except OSError:             # what it still held, or the compressed cloud, has no room
                pass
        path = self._folder / STABILISED_NAME
        if path.is_file():
            cut_to_lines(path, whole_lines(path))


def facade_facts(aligner: FacadeAligner) -> dict[str, Any]:
    """
    Return what the summary says of the facades.

    Notes
    -----
    roll_stabilised, pitch_stabilised
        Share of the points for which road or walls told roll and pitch; 0 to 1.
    yaw_corrected
        Share of the points for which walls seen by several scanners told the yaw.

    """
    counts = aligner.counts
    total = max(counts.points, 1)
    return {'rays_without_return': counts.no_return, 'rays_without_pose': counts.outside,
            'roll_stabilised': round(counts.roll_told / total, 4),
            'pitch_stabilised': round(counts.pitch_told / total, 4),
            'yaw_corrected': round(counts.yaw_told / total, 4)}
