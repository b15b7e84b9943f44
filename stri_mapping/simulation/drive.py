# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""One drive through a scene: what the scanners send, in order, and the truth beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import heapq
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stri_mapping.simulation.lms import LmsModel
from stri_mapping.simulation.scanner import TimedScan, VirtualScanner
from stri_mapping.simulation.scene import Scene
from stri_mapping.simulation.scenes import make_scene, Options
from stri_mapping.trajectory import Trajectory
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, Vehicle

Array = NDArray[np.float64]

# 2026-01-01 00:00 UTC: a fixed start, so that a seed gives the same bytes every time.
START_NS = 1767225600 * 10**9
# Interval of the ground truth in seconds; between two poses it is then right to 0.03 mm.
TRUTH_STEP = 0.01


@dataclass(frozen=True, eq=False)
class Drive:
    """
    A vehicle with its scanners in a scene.

    Attributes
    ----------
    scene, vehicle, scanners
        The scanners in the vehicle's order.
    seed
        Of everything random.

    """

    scene: Scene
    vehicle: Vehicle
    scanners: tuple[VirtualScanner, ...]
    seed: int

    def scans(self) -> Iterator[TimedScan]:
        """Iterate over the scans of all scanners in the order of their arrival."""
        streams = [s.stream(self.scene.duration) for s in self.scanners]
        return heapq.merge(*streams, key=lambda timed: timed.arrival_ns)

    def truth_times(self) -> Array:
        """Return the seconds (n,) at which the truth is stated, from 0 to the end."""
        return np.asarray(np.arange(int(self.scene.duration / TRUTH_STEP) + 1) * TRUTH_STEP)

    def truth(self) -> Trajectory:
        """Return the planar truth: base_link in odom every `TRUTH_STEP`."""
        t = self.truth_times()
        return Trajectory(START_NS + np.round(1e9 * t).astype(np.int64),
                          self.scene.motion.at(t)[:, [0, 1, 5]])

    def facts(self) -> dict[str, Any]:
        """Return what is true of the drive as plain JSON values."""
        poses = self.scene.motion.at(self.truth_times())
        return {
            'scene': self.scene.name, 'seed': self.seed, 'duration_s': self.scene.duration,
            'distance_m': float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()),
            'scanners': {s.scanner.name: {'period_s': s.period, 'phase_s': s.phase}
                         for s in self.scanners},
            **self.scene.facts,
        }


def make_drive(name: str, options: Options = Options(), model: LmsModel = LmsModel(),
               vehicle: Vehicle | None = None) -> Drive:
    """
    Set a vehicle into a scene by name.

    Parameters
    ----------
    name
        Of the scene, see `stri_mapping.simulation.scenes`.
    options
        What is asked of the scene.
    model
        Type of all its scanners; the vertical ones send intensities.
    vehicle
        By default the one in config/vehicle.yaml.

    Raises
    ------
    UsageError
        If there is no such scene or an option is out of range.

    """
    scene = make_scene(name, options)
    vehicle = vehicle or load_vehicle(default_vehicle_file())
    scanners = tuple(
        VirtualScanner(s, model, scene, options.seed, index, START_NS, s.role == 'vertical')
        for index, s in enumerate(vehicle.scanners))
    return Drive(scene, vehicle, scanners, options.seed)


def simulate(name: str, options: Options = Options(), model: LmsModel = LmsModel(),
             vehicle: Vehicle | None = None) -> tuple[list[TimedScan], Trajectory]:
    """Return all scans of a drive in the order of arrival, and its planar truth, in memory."""
    whole = make_drive(name, options, model, vehicle)
    return list(whole.scans()), whole.truth()
