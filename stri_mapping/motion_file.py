# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The path and the velocity of a drive as files that grow with it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stri_mapping.disk import cut_to_lines, keeping, whole_lines
from stri_mapping.errors import StriMappingError
from stri_mapping.results import TRAJECTORY_NAME, VELOCITY_NAME
from stri_mapping.stri.estimate import Estimate
from stri_mapping.trajectory import stamp_text, tum_line

Array = NDArray[np.float64]

VELOCITY_HEADER = 'stamp,vx,vy,wz,sigma_vx,sigma_vy,sigma_wz,quality'


class MotionWriter:
    """
    Writes trajectory.tum and velocity.csv as estimates become final; a context manager.

    Parameters
    ----------
    folder
        Existing results folder.
    append
        Go on with both files, which are there, instead of beginning them anew.

    """

    def __init__(self, folder: Path, append: bool = False) -> None:
        """Open both files."""
        self._folder = folder
        self.count = 0
        self.observed = 0                # estimates in which all of the motion was observable
        self._stretches: list[list[int]] = []
        self._degenerate = False
        if append:
            self._read_back(folder / VELOCITY_NAME)
        mode = 'a' if append else 'w'
        self._trajectory = (folder / TRAJECTORY_NAME).open(mode, encoding='utf-8')
        self._velocity = (folder / VELOCITY_NAME).open(mode, encoding='utf-8')
        if not append:
            self._velocity.write(VELOCITY_HEADER + '\n')

    def _read_back(self, path: Path) -> None:
        """Take up the counts of the estimates that were written before."""
        stamps, values = read_velocity(path)
        # quality is 1/2 where the deviation is at the limit beyond which a motion is degenerate
        for stamp, quality in zip(stamps.tolist(), values[:, 6].tolist()):
            self._note_degenerate(stamp, quality < 0.5)
        self.count, self.observed = len(stamps), int(np.sum(values[:, 6] >= 0.5))
        self._degenerate = False         # the gap that follows is no such stretch

    def __enter__(self) -> MotionWriter:
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

    def write(self, estimates: Iterable[Estimate]) -> None:
        """
        Append final estimates, in order; they are with the system when this returns.

        Raises
        ------
        ResultsError
            If the disk does not take them.

        """
        with keeping(self._folder):
            for estimate in estimates:
                self._trajectory.write(tum_line(estimate.stamp_ns, estimate.pose) + '\n')
                self._velocity.write(velocity_line(estimate) + '\n')
                self._note_degenerate(estimate.stamp_ns, estimate.degenerate)
                self.count += 1
                self.observed += not estimate.degenerate
            self._trajectory.flush()
            self._velocity.flush()

    def _note_degenerate(self, stamp_ns: int, degenerate: bool) -> None:
        """Extend the stretches in which some direction of motion was not observable."""
        if self._degenerate:                # the time since such an estimate belongs to it
            self._stretches[-1][1] = stamp_ns
        elif degenerate:
            self._stretches.append([stamp_ns, stamp_ns])
        self._degenerate = degenerate

    def facts(self) -> dict[str, Any]:
        """Return poses, degenerate_s and degenerate_stretches (pairs of seconds)."""
        return {'poses': self.count,
                'degenerate_s': sum(b - a for a, b in self._stretches) * 1e-9,
                'degenerate_stretches': [[a * 1e-9, b * 1e-9] for a, b in self._stretches]}

    def close(self) -> None:
        """Close both files."""
        with keeping(self._folder, room=0):
            self._trajectory.close()
            self._velocity.close()

    def abandon(self) -> None:
        """Close both files with the lines that are whole in both, when no more can be written."""
        for file in (self._trajectory, self._velocity):
            try:
                file.close()
            except OSError:             # what it still held has no room
                pass
        self.count = cut_to_common(self._folder)


def cut_to_common(folder: Path) -> int:
    """Cut both files to the estimates that are whole in both; return their number."""
    trajectory, velocity = folder / TRAJECTORY_NAME, folder / VELOCITY_NAME
    count = max(min(whole_lines(trajectory), whole_lines(velocity) - 1), 0)
    cut_to_lines(trajectory, count)
    cut_to_lines(velocity, count + 1)
    return count


def velocity_line(estimate: Estimate) -> str:
    """Return one line of velocity.csv: twist of base_link, its standard deviations, quality."""
    sigmas = np.sqrt(np.diag(estimate.twist_covariance))
    values = (f'{v:.6f}' for v in (*estimate.twist, *sigmas))
    return ','.join([stamp_text(estimate.stamp_ns), *values, f'{estimate.quality:.3f}'])


def read_velocity(path: Path) -> tuple[NDArray[np.int64], Array]:
    """
    Read velocity.csv.

    Returns
    -------
    stamps_ns : NDArray[np.int64]
        (n,) nanoseconds.
    values : Array
        (n, 7) the columns vx, vy, wz, sigma_vx, sigma_vy, sigma_wz, quality.

    Raises
    ------
    StriMappingError
        If the file is missing or not such a table.

    """
    try:
        header, *lines = path.read_text(encoding='utf-8').splitlines()
        if header != VELOCITY_HEADER:
            raise ValueError
        rows = [line.split(',') for line in lines]
        stamps = np.array([int(row[0].replace('.', '')) for row in rows], dtype=np.int64)
        return stamps, np.array([row[1:] for row in rows], dtype=float).reshape(-1, 7)
    except OSError as error:
        raise StriMappingError(f'{path}: {error.strerror}') from None
    except ValueError:
        raise StriMappingError(f'{path}: want a table with the header {VELOCITY_HEADER}') from None
