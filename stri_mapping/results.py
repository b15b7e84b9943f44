# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The results folder, the same for the offline command and the live graph.

trajectory.tum and velocity.csv (`motion_file`), facade.ply and facade.laz (`facade.cloud_files`)
grow while the drive goes on; summary.json (`summary`) and report.html (`report`) are made of them
at the end.
"""

from __future__ import annotations

from pathlib import Path

from stri_mapping.errors import UsageError
from stri_mapping.facade.cloud_files import PLY_NAME
from stri_mapping.facade.journal import JOURNAL_NAMES
from stri_mapping.facade.las_file import LAZ_NAME
from stri_mapping.facade.writer import STABILISED_NAME
from stri_mapping.scan_log import NAME as SCAN_LOG_NAME

TRAJECTORY_NAME, VELOCITY_NAME = 'trajectory.tum', 'velocity.csv'
SUMMARY_NAME, RANGE_IMAGE_NAME = 'summary.json', 'range_image.npz'
EVALUATION_NAME, REPORT_NAME = 'evaluation.json', 'report.html'
# Names and patterns: a cloud may have several files, a street several facades.
RESULT_NAMES = (TRAJECTORY_NAME, STABILISED_NAME, VELOCITY_NAME, PLY_NAME, LAZ_NAME,
                SUMMARY_NAME, RANGE_IMAGE_NAME, EVALUATION_NAME, REPORT_NAME,
                'facade_[0-9]*.ply', 'facade_[0-9]*.laz', 'facade*.pcd', 'facade*.e57',
                'facade_elevation_*.png', 'facade_elevation_*.pgw', *JOURNAL_NAMES,
                SCAN_LOG_NAME.format('*'))


def prepare_folder(folder: Path, overwrite: bool = False) -> None:
    """
    Make a results folder, with its parents.

    Parameters
    ----------
    folder
        Where results go.
    overwrite
        Accept a folder that holds something; results of an earlier run in it are removed,
        other files left alone.

    Raises
    ------
    UsageError
        If the path is a file, cannot be made, or holds something and `overwrite` is false.

    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()) and not overwrite:
            raise UsageError(f'{folder}: not empty; name another folder or add --overwrite')
        for path in [p for name in RESULT_NAMES for p in folder.glob(name)]:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise UsageError(f'{folder}: cannot hold results: {error.strerror}') from None
