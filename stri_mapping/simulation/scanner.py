# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A SICK LMS 2xx on the virtual vehicle: one scan for every turn of its mirror."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stri_mapping.scan import make_scan, MIRROR_TURN, Scan
from stri_mapping.simulation.beam import echo_range, SUB_RAYS, sub_rays
from stri_mapping.simulation.lms import LmsModel
from stri_mapping.simulation.scene import Scene
from stri_mapping.vehicle import Scanner

Array = NDArray[np.float64]
Turns = NDArray[np.int64]

# Scanner clocks are quartz: off by at most this share.
CLOCK = 50e-6
# A USB serial adapter with its latency timer at 1 ms hands bytes on up to this late, seconds.
ADAPTER = 0.001


@dataclass(frozen=True, eq=False)
class TimedScan:
    """A scan of one scanner and the instant at which its last byte arrived, in nanoseconds."""

    scanner: Scanner
    scan: Scan
    arrival_ns: int


class VirtualScanner:
    """
    One scanner, its mirror turning freely, carried through a scene.

    Every scan depends on the scene, the seed, the index and the number of the turn alone: taken
    one by one in real time or many at once, the scans are the same.

    Attributes
    ----------
    period
        Seconds a turn of the mirror really takes.
    phase
        Seconds from the start of the scene to turn 0.
    scene_time
        From times (n,) of rays to the times of the scene that they meet: the same, unless a live
        drive begins from rest.

    """

    def __init__(self, scanner: Scanner, model: LmsModel, scene: Scene, seed: int,
                 index: int, start_ns: int = 0, remission: bool = False) -> None:
        """
        Set the mirror turning.

        Parameters
        ----------
        scanner, model, scene
            Where it sits, what it is, and what it meets.
        seed, index
            Draw its phase, its clock and its noise; the index tells scanners apart.
        start_ns
            Time of the scene's start, nanoseconds.
        remission
            Whether it sends intensities: per cent of a white surface met head-on.

        """
        self.scanner, self.model, self.scene = scanner, model, scene
        self.start_ns, self.remission = start_ns, remission
        self.scene_time: Callable[[Array], Array] = lambda times: times
        self._key = np.random.SeedSequence((seed, index)).generate_state(2, np.uint64)
        self.period, self.phase = mirror_clock(seed, index)

    def count(self, duration: float) -> int:
        """Return how many turns end within the first `duration` seconds."""
        return max(0, int((duration - self.phase) / self.period))

    def stream(self, duration: float, block: int = 32) -> Iterator[TimedScan]:
        """Iterate over all scans of the first `duration` seconds, computed block by block."""
        count = self.count(duration)
        for first in range(0, count, block):
            yield from self.turns(first, min(first + block, count))

    def turns(self, first: int, last: int) -> list[TimedScan]:
        """Return the scans of turns `first` to `last` - 1 of the mirror, one a turn."""
        scans: dict[int, TimedScan] = {}
        for raster in range(self.model.rasters):
            numbers = np.arange(first, last)
            numbers = numbers[numbers % self.model.rasters == raster]
            if len(numbers):
                scans.update(zip(numbers.tolist(), self._turns_of(raster, numbers)))
        return [scans[k] for k in range(first, last)]

    def ray_times(self, numbers: Turns) -> Array:
        """
        Return the time (turns, rays) of every ray, seconds, for turns of one raster.

        The ray at bearing a of turn q comes at ``t0 + T (q + a / 360)``, a from the right.
        """
        from_right = self.model.bearings(int(numbers[0]) % self.model.rasters) + 90.0
        return np.asarray(
            self.phase + self.period * (numbers[:, None] + from_right[None, :] / 360.0))

    def _turns_of(self, raster: int, numbers: Turns) -> list[TimedScan]:
        """Return the scans of turns that share a raster."""
        bearings = np.deg2rad(self.model.bearings(raster))
        times = self.ray_times(numbers)
        ranges, energy = self.exact(self.scene_time(times.ravel()),
                                    np.tile(bearings, len(numbers)))
        rows = zip(numbers.tolist(), times[:, 0], ranges.reshape(times.shape),
                   energy.reshape(times.shape))
        return [self._scan(k, float(t), float(bearings[0]), r, e) for k, t, r, e in rows]

    def exact(self, times: Array, bearings: Array) -> tuple[Array, Array]:
        """
        Return what beams would read without noise, and the light each got back.

        Parameters
        ----------
        times, bearings
            (n,) seconds and radians.

        Returns
        -------
        ranges, energy : Array
            (n,) metres, +inf for no light, NaN where the sun dazzles; energy as `Scene.look`
            defines it.

        """
        origins, directions = sub_rays(
            self.scene.motion.at(times), bearings, self.scanner.T_base_laser, self.model.spot,
            self.model.divergence)
        distance, energy = self.scene.look(times, origins, directions)
        ranges, total = echo_range(distance.reshape(-1, SUB_RAYS), energy.reshape(-1, SUB_RAYS),
                                   self.model.echo)
        ranges[self.scene.dazzled(directions[::SUB_RAYS], ranges)] = np.nan
        return ranges, total / SUB_RAYS

    def _scan(self, number: int, begin: float, first_bearing: float, ranges: Array,
              energy: Array) -> TimedScan:
        """Return one turn as the scanner sends it, noise, limits, quantisation and all."""
        model, n = self.model, len(ranges)
        rng = np.random.Generator(np.random.Philox(key=self._key, counter=number << 64))
        noise, fading, speckle = rng.standard_normal((3, n))
        lost, late = rng.random(n) < model.dropout, rng.random()
        dark = energy * np.exp(0.1 * fading) < 0.1 / model.reach**2
        finite = np.where(np.isfinite(ranges), ranges, 0.0)
        measured = finite + model.noise * np.maximum(1.0, finite / 20.0) * noise
        sent = np.maximum(model.quantisation * np.round(measured / model.quantisation), 0.0)
        sent[lost | dark | (sent > model.range_max)] = np.inf
        sent[np.isnan(ranges)] = np.nan
        intensities = None
        if self.remission:
            white = 100.0 * energy * finite**2 * (1.0 + 0.03 * speckle)
            intensities = np.where(np.isfinite(sent), np.round(white), 0.0)
        scan = make_scan(
            self.start_ns + round(1e9 * begin), sent.astype(np.float32), _f32(first_bearing),
            _f32(np.deg2rad(1.0)), _f32(MIRROR_TURN / 360.0), 0.0, _f32(model.range_max),
            intensities)
        end = self.phase + self.period * (number + 1) + model.transfer(n) + ADAPTER * late
        return TimedScan(self.scanner, scan, self.start_ns + round(1e9 * end))


def mirror_clock(seed: int, index: int) -> tuple[float, float]:
    """Return the period and the phase in seconds of a scanner's mirror, drawn from a seed."""
    rng = np.random.default_rng(np.random.SeedSequence((seed, index)).spawn(1)[0])
    period = MIRROR_TURN * (1.0 + CLOCK * rng.uniform(-1.0, 1.0))
    return period, float(rng.uniform(0.0, period))


def _f32(value: float) -> float:
    """Return a number as a LaserScan's float32 field will give it back."""
    return float(np.float32(value))
