# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What the aligner leaves in a results folder, the same for `map` and for the live node."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

from stri_mapping.facade.cloud_files import CloudWriter
from stri_mapping.facade.points import FacadePoints
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.trajectory import read_tum, spatial_tum_line

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
        self._cloud.write(points)
        if self._poses is not None:
            stamps, poses = aligner.take_poses()
            new = stamps > self._written_ns      # after a crash the path comes whole again
            for stamp, pose in zip(stamps[new].tolist(), poses[new]):
                self._poses.write(spatial_tum_line(stamp, pose) + '\n')
            self._poses.flush()
        return points

    def close(self) -> None:
        """Finish all files; a second call does nothing."""
        if self._poses is not None:
            self._poses.close()
        self._cloud.close()


def facade_facts(aligner: FacadeAligner) -> dict[str, Any]:
    """
    Return what the summary says of the facades.

    Notes
    -----
    roll_stabilised, pitch_stabilised
        Share of the points for which road or walls told roll and pitch; 0 to 1.

    """
    counts = aligner.counts
    total = max(counts.points, 1)
    return {'rays_without_return': counts.no_return, 'rays_without_pose': counts.outside,
            'roll_stabilised': round(counts.roll_told / total, 4),
            'pitch_stabilised': round(counts.pitch_told / total, 4)}
