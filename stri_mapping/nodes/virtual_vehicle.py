# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node: a virtual vehicle at true times, its scanners behind pseudo terminals."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
import sys

from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.node import Node

from stri_mapping.errors import UsageError
from stri_mapping.nodes.conversions import truth_messages
from stri_mapping.nodes.diagnostics import Diagnostics, OK, Report, WARN
from stri_mapping.nodes.parameters import declare, setting
from stri_mapping.nodes.process import (
    ACKNOWLEDGE,
    guarded,
    StopRequest,
    warn_of_unknown_parameters,
)
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

try:
    from stri_mapping.lms_emulator.faults import read_plans
    from stri_mapping.lms_emulator.priority import ahead_of_others
    from stri_mapping.simulation.drive import TRUTH_STEP
    from stri_mapping.simulation.lms import variant
    from stri_mapping.simulation.pilot import Pilot, Trip
    from stri_mapping.simulation.scenes import Options
except ImportError as error:
    sys.exit(f'the package "{error.name}" is missing: pip install "stri_mapping[simulation]"')

TRUTH_TOPIC = '/ground_truth/odom'
# Seconds between two looks at what there is to publish.
LOOK = 0.05


@dataclass(frozen=True)
class VirtualVehicleSettings:
    """
    What the virtual vehicle can be told.

    Attributes
    ----------
    scene
        Name of the scene; "stri-mapping simulate list" names them all.
    ports
        Folder for the links to the scanners' ports, named like the scanners.
    vehicle_file
        Path of the vehicle description; empty for the one that comes with the package.
    seed
        Draws everything random.
    duration
        Seconds of the scene; 0 for the scene's own.
    variant
        Scanner type and setting: field x resolution in degrees.
    vibration
        Scale of roll, pitch and heave: 1 an ordinary car, 0 none.
    traffic
        How much moves in the street: 1 an ordinary one, 0 nothing.
    wait
        Whether to stand still until all scanners stream.
    patience
        Seconds to wait for that; 0 for ever.
    settle
        Seconds standing still, all scanners streaming, before the drive.
    linger
        Seconds standing still after the drive.
    rate
        Line rate in baud at which the scanners are found.
    faults
        Path of a plan of faults, YAML or JSON; empty for none.
    readers
        Subscribers that each scanner's topic is to have before the drive.
    resume
        Whether to begin where an earlier vehicle with the same ports came to.

    """

    scene: str = ''
    ports: str = ''
    vehicle_file: str = ''
    seed: int = 1
    duration: float = 0.0
    variant: str = '180x1'
    vibration: float = 1.0
    traffic: float = 1.0
    wait: bool = True
    patience: float = setting(900.0, 0.0, 1e6)
    settle: float = setting(3.0, 0.0, 1e6)
    linger: float = setting(1.0, 0.0, 1e6)
    rate: int = 9600
    faults: str = ''
    readers: int = setting(0, 0, 100)
    resume: bool = False

    def trip(self) -> Trip:
        """Return what is to be driven."""
        for name in ('scene', 'ports'):
            if not getattr(self, name):
                raise UsageError(f'parameter {name} is missing')
        options = Options(self.seed, self.duration or None, self.vibration, self.traffic)
        options.check()
        file = Path(self.vehicle_file) if self.vehicle_file else default_vehicle_file()
        return Trip(
            self.scene, options, load_vehicle(file), variant(self.variant), Path(self.ports),
            wait=self.wait, patience=self.patience, settle=self.settle, linger=self.linger,
            rate=self.rate, faults=read_plans(Path(self.faults)) if self.faults else {},
            resume=self.resume)


class VirtualVehicle:
    """Drives in a thread of its own, and publishes the truth meanwhile."""

    def __init__(self, stop: StopRequest) -> None:
        """Declare the parameters; the vehicle appears in `run`."""
        self.node = Node('virtual_vehicle')
        settings = declare(self.node, VirtualVehicleSettings)
        self.pilot, self._readers = Pilot(settings.trip()), settings.readers
        warn_of_unknown_parameters(self.node)
        self._stop = stop
        self._told = 0                          # poses of the truth published
        self._truth = self.node.create_publisher(Odometry, TRUTH_TOPIC, 1000)
        self._diagnostics = Diagnostics(self.node, {'drive': self._report})

    def run(self) -> None:
        """Drive to the end, or until asked to stop."""
        with ThreadPoolExecutor(1) as pool:
            drive = pool.submit(self.pilot.run, lambda: self._stop.requested, self._heard)
            while not drive.done():
                rclpy.spin_once(self.node, timeout_sec=LOOK)
                self._publish_truth()
        drive.result()
        self._truth.wait_for_all_acked(ACKNOWLEDGE)
        log, pilot = self.node.get_logger(), self.pilot
        log.info(f'{sum(pilot.state.scans)} scans sent, {pilot.starved} left out; bytes were '
                 f'late by {pilot.state.lateness}')

    def _heard(self) -> bool:
        """Return whether every scanner's topic has its readers."""
        return all(self.node.count_subscribers(scanner.topic) >= self._readers
                   for scanner in self.pilot.trip.vehicle.scanners)

    def _publish_truth(self) -> None:
        """Publish the poses since last time, whose stamps are multiples of the truth's step."""
        live = self.pilot.live
        if live is None:
            return
        last = int(self.pilot.now / TRUTH_STEP)
        first = self._told or last
        self._told = last + 1
        times = np.asarray(TRUTH_STEP * np.arange(first, last + 1))
        stamps = [self.pilot.epoch_ns + round(1e9 * t) for t in times.tolist()]
        for message in truth_messages(stamps, *live.poses(times)):
            self._truth.publish(message)

    def _report(self) -> Report:
        pilot = self.pilot
        state, late = pilot.state, pilot.state.lateness
        values = {
            'Scans': sum(state.scans), 'Scans left out': pilot.starved,
            'Lateness p50': f'{1e3 * late.p50:.2f} ms', 'Lateness p99': f'{1e3 * late.p99:.2f} ms',
            'Lateness max': f'{1e3 * late.worst:.2f} ms',
            'Real-time priority': 'yes' if state.real_time else 'not allowed',
            'Scanners not streaming': ', '.join(pilot.missing) or 'none',
            'Second 0 (ns)': pilot.epoch_ns, **{
                f'{name}: turn 0, turn (s)': f'{phase:.9f}, {period:.12f}'
                for name, (period, phase) in pilot.mirrors.items()}}
        if pilot.starved:
            return Report(WARN, f'{pilot.phase}; this machine casts rays too slowly', values)
        return Report(OK, pilot.phase, values)


def main(args: list[str] | None = None) -> int:
    """Run the node until the drive is over."""
    ahead_of_others()
    return guarded(lambda stop: VirtualVehicle(stop).run(), args)


if __name__ == '__main__':
    sys.exit(main())
