# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Drives a virtual vehicle at true times: scanners behind ptys, and a scene around them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
import logging
from pathlib import Path
import time

import numpy as np

from stri_mapping.errors import StriMappingError, UsageError
from stri_mapping.lms_emulator.faults import Fault
from stri_mapping.lms_emulator.line import Adapter
from stri_mapping.lms_emulator.model import make_memory, Memory
from stri_mapping.lms_emulator.priority import behind_the_eager
from stri_mapping.lms_emulator.process import EmulatorProcess, Setup, State
from stri_mapping.lms_emulator.turns import Mirror, Variant
from stri_mapping.simulation.drive import make_drive
from stri_mapping.simulation.live import LiveDrive
from stri_mapping.simulation.lms import LmsModel
from stri_mapping.simulation.scanner import mirror_clock
from stri_mapping.simulation.scenes import Options
from stri_mapping.vehicle import Vehicle

logger = logging.getLogger(__name__)

# Where the second of the scene is kept, for a vehicle that is started again.
ELAPSED_NAME = 'elapsed'
# Seconds between two looks at what there is to do, and between two renewals of that file.
LOOK, ELAPSED_PERIOD = 0.01, 0.1
# 32 m in millimetres: 15 bits of distance.
FINE_MODE = 0x06


@dataclass(frozen=True)
class Trip:
    """
    What is to be driven.

    Attributes
    ----------
    scene, options, vehicle, model
        As `make_drive` takes them.
    ports
        Folder for the ports' links, named like the scanners.
    wait
        Whether to stand still until all scanners stream.
    patience
        Seconds to wait for that; 0 for ever.
    settle, linger
        Seconds standing still before and after the drive.
    rate
        Line rate at which the scanners are found, baud.
    faults
        By scanner: what goes wrong.
    adapter
        The host's end of the serial lines.
    resume
        Whether to begin where an earlier vehicle with the same folder came to.

    """

    scene: str
    options: Options
    vehicle: Vehicle
    model: LmsModel
    ports: Path
    wait: bool = True
    patience: float = 900.0
    settle: float = 3.0
    linger: float = 1.0
    rate: int = 9600
    faults: dict[str, list[Fault]] = field(default_factory=dict)
    adapter: Adapter = Adapter(latency=0.002)
    resume: bool = False


class Pilot:
    """
    Drives once.

    Attributes
    ----------
    epoch, epoch_ns
        The instant from which the seconds of `live` count, on `time.monotonic` and as host time in
        nanoseconds.  The ray at bearing -90 + a degrees of turn q of a scanner was sent at
        ``epoch_ns + 1e9 (phase + period (q + a / 360))``, from the pose of that very time.
    live
        The vehicle; None until its scene is built.
    state
        Of the scanners, as last heard.
    phase
        What is going on, in words.

    """

    def __init__(self, trip: Trip) -> None:
        """Take what to drive; nothing happens before `run`."""
        self.trip = trip
        self.epoch, self.epoch_ns = time.monotonic(), time.time_ns()
        self.live: LiveDrive | None = None
        self.state = State()
        self.phase = 'building the scene'
        self._starved_before: int | None = None      # the drive
        self._written = 0.0

    @property
    def mirrors(self) -> dict[str, tuple[float, float]]:
        """Period and phase in seconds of each scanner's mirror, by the scanner's name."""
        return {scanner.name: mirror_clock(self.trip.options.seed, index)
                for index, scanner in enumerate(self.trip.vehicle.scanners)}

    @property
    def now(self) -> float:
        """Seconds since the epoch."""
        return time.monotonic() - self.epoch

    @property
    def missing(self) -> list[str]:
        """Names of the scanners that do not stream."""
        return [s.name for s, want in zip(self.trip.vehicle.scanners, self.state.wants)
                if want is None]

    @property
    def starved(self) -> int:
        """Scans that were left out on the drive because rays were not cast in time."""
        before = self._starved_before
        return 0 if before is None else sum(self.state.starved) - before

    def run(self, stopped: Callable[[], bool], ready: Callable[[], bool] = lambda: True) -> None:
        """
        Drive from the first moment to the end, or until stopped.

        Parameters
        ----------
        stopped
            Whether to end.
        ready
            Whether the drive may begin, once all scanners stream.

        Raises
        ------
        UsageError
            If scene, options or folder cannot be.
        StriMappingError
            If nobody listens to a scanner for too long, or the emulator fails.

        """
        trip = self.trip
        try:
            trip.ports.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f'parameter ports: {trip.ports}: {error.strerror}') from None
        first = self._elapsed() if trip.resume else 0.0
        with EmulatorProcess(trip.ports, self._setups(), trip.adapter) as emulator:
            drive = make_drive(trip.scene, trip.options, trip.model, trip.vehicle)
            for scanner in drive.scanners:      # compiles what is not yet
                scanner.turns(0, 1)
            live = LiveDrive(drive, min(first, drive.scene.duration))
            self.live = live
            self._drive(live, emulator, stopped, ready)
            self.state = emulator.end(at_rest=not stopped())

    def _drive(self, live: LiveDrive, emulator: EmulatorProcess, stopped: Callable[[], bool],
               ready: Callable[[], bool]) -> None:
        trip, began = self.trip, self.now
        behind_the_eager()
        self.phase = 'standing still until all scanners stream'
        while trip.wait and not stopped() and (self.missing or not self.state.wants):
            self._step(live, emulator)
            if 0.0 < trip.patience < self.now - began:
                raise StriMappingError(
                    f'no driver has made {self.missing[0]} stream from '
                    f'{trip.ports / self.missing[0]} within {trip.patience:.0f} s')
        self.phase = 'standing still until all scans are read'
        while not stopped() and not ready():
            self._step(live, emulator)
            if 0.0 < trip.patience < self.now - began:
                raise StriMappingError(
                    f'not every scanner has its readers within {trip.patience:.0f} s')
        live.go(self.now + trip.settle)
        self.phase = 'standing still before the drive'
        while not stopped() and self.now < live.timeline.begin:
            self._step(live, emulator)
        self._starved_before = sum(self.state.starved)
        self.phase = 'driving'
        while not stopped() and self.now < live.timeline.end:
            self._step(live, emulator)
            self._keep_elapsed(live)
        self.phase = 'standing still after the drive'
        while not stopped() and self.now < live.timeline.end + trip.linger:
            self._step(live, emulator)
        self.phase = 'over'

    def _step(self, live: LiveDrive, emulator: EmulatorProcess) -> None:
        """Cast one batch, or wait a moment if that is not needed."""
        for index, want in enumerate(self.state.wants):
            live.want(index, want, self.now)
        turns = live.cast(self.now)
        if turns is not None:
            emulator.feed(turns)
        self.state = emulator.poll(0.0 if turns is not None else LOOK)

    def _setups(self) -> Sequence[Setup]:
        trip, mirrors = self.trip, self.mirrors
        for name in trip.faults:
            if name not in mirrors:
                raise UsageError(f'faults of "{name}": the scanners are {", ".join(mirrors)}')
        return [Setup(name, Mirror(self.epoch + phase, period),
                      _memory(trip.model, trip.rate, index), tuple(trip.faults.get(name, ())),
                      trip.options.seed + index)
                for index, (name, (period, phase)) in enumerate(mirrors.items())]

    def _elapsed(self) -> float:
        """Return the second of the scene that an earlier vehicle came to; 0 for none."""
        try:
            return float((self.trip.ports / ELAPSED_NAME).read_text(encoding='ascii'))
        except (OSError, ValueError):
            return 0.0

    def _keep_elapsed(self, live: LiveDrive) -> None:
        if self.now < self._written + ELAPSED_PERIOD:
            return
        self._written = self.now
        fresh = self.trip.ports / f'.{ELAPSED_NAME}'
        seconds = float(live.timeline.scene(np.array([self.now]))[0])
        try:
            fresh.write_text(f'{seconds:.3f}\n', encoding='ascii')
            fresh.replace(self.trip.ports / ELAPSED_NAME)
        except OSError as error:        # the drive goes on; only a restart would miss it
            logger.warning('%s: %s', fresh, error.strerror)


def _memory(model: LmsModel, rate: int, index: int) -> Memory:
    """Return a scanner of the simulated type, set to what the simulation has it measure."""
    memory = make_memory('LMS200' if model.reach < 20.0 else 'LMS291', rate)
    memory.serial_number = f'{20260001 + index}'
    memory.variant = Variant(round(model.field), round(100.0 * model.resolution))
    if model.quantisation < 0.01:
        memory.configuration = memory.configuration.changed(unit=1, measuring_mode=FINE_MODE)
    return memory
