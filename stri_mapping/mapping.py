# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A drive mapped offline: scans in recorded order through the cores into a results folder."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from pathlib import Path
import time
from typing import Any

import numpy as np

from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.facade.writer import facade_facts, FacadeWriter
from stri_mapping.motion_file import MotionWriter
from stri_mapping.results import RANGE_IMAGE_NAME
from stri_mapping.scan import Scan, ScanCounts
from stri_mapping.stri.config import EstimatorConfig
from stri_mapping.stri.estimator import StriEstimator
from stri_mapping.summary import scanner_facts
from stri_mapping.vehicle import Scanner, Vehicle

# Refined poses gathered before the facades are asked for: a second or so of driving, so that
# scan lines are placed many at a time.
POSES_AT_ONCE = 64


class Mapper:
    """
    Maps one drive: what the nodes do live, in one loop.

    Parameters
    ----------
    vehicle
        The scanners whose scans will come.
    folder
        Existing results folder; trajectory, velocity and cloud grow in it as scans come.

    """

    def __init__(self, vehicle: Vehicle, folder: Path) -> None:
        """Open the result files and compile the estimator where it is not yet."""
        self.vehicle = vehicle
        self.folder = folder
        self.estimator = StriEstimator(
            vehicle.horizontal.T_base_laser,
            EstimatorConfig().knowing(vehicle.horizontal.footprint_pull))
        self.estimator.warm_up()
        self.aligner = FacadeAligner(vehicle.verticals,
                                     vehicle.horizontal.T_base_laser[:3, 3])
        self.aligner.warm_up()
        self._rings = {s.name: ring for ring, s in enumerate(vehicle.verticals)}
        self._stamps = {s.name: array('q') for s in vehicle.scanners}
        self._motion = MotionWriter(folder)
        self._facade = FacadeWriter(folder, list(self._rings))
        self._poses_waiting = 0
        self._estimating = 0.0
        self._started = time.perf_counter()

    @property
    def moved(self) -> bool:
        """Whether the scans told the motion at any time so far."""
        return self._motion.observed > 0

    def add(self, scanner: Scanner, scan: Scan) -> None:
        """Take the next scan of any scanner, in recorded order."""
        self._stamps[scanner.name].append(scan.stamp_ns)
        if scanner.role == 'vertical':
            self.aligner.add_scan(self._rings[scanner.name], scan)
            return
        began = time.perf_counter()
        self.estimator.add(scan)
        self._take_refined()
        self._estimating += time.perf_counter() - began
        if self._poses_waiting >= POSES_AT_ONCE:
            self._take_points()

    def _take_refined(self) -> None:
        refined = self.estimator.take_refined()
        if refined:
            self._motion.write(refined)
            self.aligner.add_poses([e.stamp_ns for e in refined], [e.pose for e in refined])
            self._poses_waiting += len(refined)

    def _take_points(self) -> None:
        self._facade.take(self.aligner)
        self._poses_waiting = 0

    def finish(self) -> None:
        """Make everything final and close the files; no scan will follow."""
        try:
            self.estimator.finish()
            self._take_refined()
            self.aligner.finish()
            self._take_points()
            self.estimator.range_image_log.save(self.folder / RANGE_IMAGE_NAME)
        finally:
            self._motion.close()
            self._facade.close()

    def facts(self, counts: Mapping[str, ScanCounts]) -> dict[str, Any]:
        """
        Return what `write_summary` is to know of the drive.

        Parameters
        ----------
        counts
            By scanner name, what was met while reading its topic.

        Notes
        -----
        real_time_factor
            Recorded seconds of the horizontal scanner over seconds spent from the first scan to
            the finished cloud, reading included; compiling and the report are not.
        ms_per_scan
            Mean time of the estimator alone for a horizontal scan.
        footprint_pull
            1/m, as learnt by the end of the drive.

        """
        wall = time.perf_counter() - self._started
        stamps = np.array(self._stamps[self.vehicle.horizontal.name], dtype=np.int64)
        recorded = float(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) else 0.0
        return {
            'scans': len(stamps), 'wall_s': round(wall, 3),
            'real_time_factor': round(recorded / wall, 2),
            'ms_per_scan': round(1e3 * self._estimating / max(len(stamps), 1), 3),
            'footprint_pull': self.estimator.footprint_pull,
            **facade_facts(self.aligner), **self._motion.facts(),
            'scanners': [scanner_facts(self.vehicle, s, self._stamps[s.name], counts.get(s.name))
                         for s in self.vehicle.scanners]}
