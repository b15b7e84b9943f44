# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the aligner leaves in a results folder, the same for `map` and for the live node."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from stri_mapping.disk import end_whole, keeping
from stri_mapping.facade.cloud_files import CloudWriter
from stri_mapping.facade.points import FacadePoints
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.trajectory import spatial_tum_line, stamp_of

Stamps = NDArray[np.int64]
Array = NDArray[np.float64]
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
        self._folder = folder
        self._cloud = CloudWriter(folder, names, append=append)
        self._poses: TextIO | None = None
        self._written_ns = -1                    # newest pose in the file
        path = folder / STABILISED_NAME
        if append and path.is_file():
            line = end_whole(path)
            self._written_ns = stamp_of(line.split()[0]) if line else -1
        if names:
            self._poses = path.open('a' if append else 'w', encoding='utf-8')
        elif not append:
            path.unlink(missing_ok=True)

    def take(self, aligner: FacadeAligner) -> FacadePoints:
        """Write what became final in the aligner; return the points."""
        points = aligner.take_points()
        self.write(points, *aligner.take_poses())
        return points

    def write(self, points: FacadePoints, stamps: Stamps, poses: Array) -> None:
        """
        Write points, and poses (n, 6) with their stamps (n,).

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

    def close(self) -> None:
        """Finish all files; a second call does nothing."""
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
            end_whole(path)


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

    def share(told: int) -> float:
        # after a crash some of a tenth of a second may have been counted twice
        return round(min(told / max(counts.points, 1), 1.0), 4)
    return {'rays_without_return': counts.no_return, 'rays_without_pose': counts.outside,
            'roll_stabilised': share(counts.roll_told),
            'pitch_stabilised': share(counts.pitch_told),
            'yaw_corrected': share(counts.yaw_told)}
