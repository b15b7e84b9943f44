# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
summary.json: what there is to know of a drive in numbers and in words.

Several processes may each add their facts to one summary in turn.
"""

from __future__ import annotations

from collections.abc import Mapping
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stri_mapping import __version__, geometry
from stri_mapping.disk import keeping
from stri_mapping.errors import StriMappingError
from stri_mapping.facade.cloud_files import count_points, PLY_NAME
from stri_mapping.motion_file import read_velocity
from stri_mapping.results import SUMMARY_NAME, TRAJECTORY_NAME, VELOCITY_NAME
from stri_mapping.scan import ScanCounts
from stri_mapping.trajectory import read_tum
from stri_mapping.vehicle import Scanner, Vehicle

Array = NDArray[np.float64]

# Seconds between two poses that still make one path.
LONGEST_STEP = 0.5


def lost_scans(stamps_ns: ArrayLike) -> int:
    """
    Return how many scans are missing between the first and the last.

    A gap of about k periods (their median) counts k - 1 lost scans.  Where stamps are late and
    the next ones make up for it nothing was lost: a gap counts only by what is still open a few
    scans later.  Where fewer than half of the gaps are about a period, scans come at no fixed
    rate, and 0 is returned: what is missing cannot be told.

    Parameters
    ----------
    stamps_ns
        (n,) stamps of one scanner's scans, nanoseconds, increasing.

    """
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    if len(stamps) < 3:
        return 0
    gaps = np.diff(stamps)
    period = float(np.median(gaps))
    if np.mean(np.abs(gaps - period) < 0.25 * period) < 0.5:
        return 0
    lost = 0
    for i in np.flatnonzero(gaps > 1.5 * period):
        later = (stamps[i + 1:i + 9] - stamps[i]) / period
        lost += max(round(float(np.min(later - np.arange(1, len(later) + 1)))), 0)
    return lost


def pose_gaps(stamps_ns: ArrayLike) -> list[tuple[int, int]]:
    """
    Return the stretches (from, to) in nanoseconds in which a path has no pose.

    Such a stretch is longer than `LONGEST_STEP` seconds and five times the median step.
    """
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    steps = np.diff(stamps)
    if not len(steps):
        return []
    wide = steps > max(LONGEST_STEP * 1e9, 5.0 * float(np.median(steps)))
    return [(int(stamps[i]), int(stamps[i + 1])) for i in np.flatnonzero(wide)]


def scanner_facts(
    vehicle: Vehicle, scanner: Scanner, stamps_ns: ArrayLike, counts: ScanCounts | None = None,
) -> dict[str, Any]:
    """
    Return what the summary says of one scanner, an entry of its list `scanners`.

    Parameters
    ----------
    vehicle
        Gives a vertical scanner its number in the cloud, `point_source_id`.
    scanner
        The scanner.
    stamps_ns
        (n,) stamps of its scans.
    counts
        What was met on its topic.

    """
    met = counts or ScanCounts()
    T = scanner.T_base_laser
    verticals = [s.name for s in vehicle.verticals]
    source = {'point_source_id': verticals.index(scanner.name) + 1} if (
        scanner.name in verticals) else {}
    return {
        'name': scanner.name, 'role': scanner.role, 'topic': scanner.topic,
        'frame': scanner.frame, **source,
        'mount': {'xyz': _rounded(T[:3, 3]),
                  'rpy': _rounded(geometry.rpy_from_rotation(T[:3, :3]))},
        'scans': met.read, 'lost_scans': lost_scans(stamps_ns), 'malformed_scans': met.malformed,
        'backwards_scans': met.backwards, 'scans_without_return': met.without_returns}


def _rounded(values: Array) -> list[float]:
    return [float(v) for v in np.round(values, 9) + 0.0]    # no negative zeros


def write_summary(folder: Path, facts: Mapping[str, Any]) -> dict[str, Any]:
    """
    Add facts to summary.json, with the figures that follow from them and the other files.

    Parameters
    ----------
    folder
        Results folder.
    facts
        JSON values by name; they replace facts of the same name written before.  Only `messages`
        are appended to those there, and `scanners` replace those of the same name.

    Returns
    -------
    dict
        The whole summary as written; `warnings` are the messages and what the figures tell.

    Raises
    ------
    ResultsError
        If the disk does not take it.

    """
    before = read_summary(folder)
    summary: dict[str, Any] = {'version': __version__, **before, **facts}
    summary['messages'] = [*before.get('messages', []), *facts.get('messages', [])]
    by_name = {s['name']: s for s in [*before.get('scanners', []), *facts.get('scanners', [])]}
    summary['scanners'] = list(by_name.values())
    for key in ('lost_scans', 'malformed_scans', 'backwards_scans', 'scans_without_return'):
        summary[key] = sum(s[key] for s in summary['scanners'])
    summary.update(_figures(folder))
    summary['warnings'] = [*summary['messages'], *_remarks(summary)]
    part = folder / f'{SUMMARY_NAME}.{os.getpid()}'     # nodes may come to their end together
    try:
        with keeping(folder, room=0):
            part.write_text(json.dumps(summary, indent=2) + '\n', encoding='utf-8')
            os.replace(part, folder / SUMMARY_NAME)
    finally:
        part.unlink(missing_ok=True)
    return summary


def _remarks(summary: Mapping[str, Any]) -> list[str]:
    """Return one line for each figure that a user should know of before trusting the rest."""
    remarks = []
    for scanner in summary['scanners']:
        remarks += [f'{scanner["name"]}: {scanner[key]} {what} beside {scanner["scans"]} good ones'
                    for key, what in (('lost_scans', 'scans are missing'),
                                      ('malformed_scans', 'malformed scans were left out'),
                                      ('backwards_scans', 'scans whose stamp ran backwards were '
                                       'left out')) if scanner[key]]
        if scanner['scans_without_return']:
            remarks.append(f'{scanner["name"]}: {scanner["scans_without_return"]} of '
                           f'{scanner["scans"]} scans hit nothing')
    if summary.get('degenerate_s', 0.0) >= 0.05:
        remarks.append(f'for {summary["degenerate_s"]:.1f} s the surroundings did not tell the '
                       'motion; it was carried on from before')
    remarks += [f'no pose for {end - start:.1f} s from {start:.3f} on'
                for start, end in summary.get('gaps', [])]
    if summary.get('rays_without_pose', 0) > 0.05 * max(summary['points'], 1):
        remarks.append(f'{summary["rays_without_pose"]} rays of the vertical scanners have no '
                       'pose at their time and were left out')
    for what in ('roll', 'pitch'):
        share = summary.get(f'{what}_stabilised', 1.0)
        if share < 0.95 and summary['points']:
            remarks.append(f'for {100.0 * (1.0 - share):.0f} % of the points neither road nor '
                           f'walls told the {what}; it is left at zero there')
    return remarks


def read_summary(folder: Path) -> dict[str, Any]:
    """
    Return summary.json; an empty one where there is none.

    Raises
    ------
    StriMappingError
        If it is not a JSON object.

    """
    path = folder / SUMMARY_NAME
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except ValueError:
        content = None
    if not isinstance(content, dict):
        raise StriMappingError(f'{path}: want a JSON object')
    return content


def _figures(folder: Path) -> dict[str, Any]:
    """Return what trajectory, velocity and cloud say of the drive as a whole."""
    figures: dict[str, Any] = {'points': count_points(folder / PLY_NAME)}
    if (folder / TRAJECTORY_NAME).is_file():
        path = read_tum(folder / TRAJECTORY_NAME)
        gaps = pose_gaps(path.stamps_ns)
        figures.update(distance_m=round(path.distance, 3), duration_s=round(path.duration, 6),
                       gaps=[[a * 1e-9, b * 1e-9] for a, b in gaps])
    if (folder / VELOCITY_NAME).is_file():
        _, values = read_velocity(folder / VELOCITY_NAME)
        if len(values):
            speed = np.hypot(values[:, 0], values[:, 1])
            sigma = np.hypot(values[:, 3], values[:, 4])
            figures.update(mean_speed_mps=round(float(speed.mean()), 4),
                           max_speed_mps=round(float(speed.max()), 4),
                           median_sigma_mps=round(float(np.nanmedian(sigma)), 5))
    return figures
