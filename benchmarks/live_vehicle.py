# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure a live virtual vehicle: share of a core, lateness of bytes, scans left out.

Hosts that only read make all scanners send one scan a turn of the mirror at 500 kBd.  `--load`
keeps so many processes busy beside it, as the nodes of a live graph would.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from stri_mapping.lms.requests import (
    EVERY_TURN,
    ON_REQUEST,
    RATES,
    Request,
    SetVariant,
    SwitchMode,
)
from stri_mapping.lms.telegram import frame
from stri_mapping.lms_emulator.priority import ahead_of_others
from stri_mapping.simulation.lms import variant
from stri_mapping.simulation.pilot import Pilot, Trip
from stri_mapping.simulation.scenes import Options
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

BUSY = 'while True: sum(range(100000))'
LOOK = 0.1


def host(path: Path) -> None:
    """Make a scanner stream, and read until it is gone."""
    import serial

    def ask(request: Request) -> None:
        port.write(frame(request.encode()))
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            port.read(port.in_waiting or 1)

    while not path.exists():
        time.sleep(LOOK)
    with serial.Serial(str(path), 9600, timeout=1.0) as port:
        ask(SwitchMode(RATES[500000]))
        port.baudrate = 500000
        ask(SetVariant(180, 100))
        ask(SwitchMode(EVERY_TURN))
        while path.exists():
            port.read(port.in_waiting or 1)
        ask(SwitchMode(ON_REQUEST))


def main() -> None:
    """Drive once and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scene', nargs='?', default='street')
    parser.add_argument('--duration', type=float, default=30.0)
    parser.add_argument('--load', type=int, default=0, help='busy processes beside it')
    parser.add_argument('--host', type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.host:
        host(args.host)
        return
    vehicle = load_vehicle(default_vehicle_file())
    with ExitStack() as stack, tempfile.TemporaryDirectory() as folder:
        commands = [[__file__, '--host', f'{folder}/{s.name}'] for s in vehicle.scanners]
        commands += [['-c', BUSY]] * args.load
        for command in commands:
            stack.callback(subprocess.Popen([sys.executable, *command]).kill)
        ahead_of_others()
        pilot = Pilot(Trip(args.scene, Options(duration=args.duration), vehicle,
                           variant('180x1'), Path(folder), patience=60.0))
        measure(pilot)


def measure(pilot: Pilot) -> None:
    """Drive, and print what it took while the vehicle moved."""
    with ThreadPoolExecutor(1) as pool:
        drive = pool.submit(pilot.run, lambda: False)
        marks = []
        for phase in ('driving', 'standing still after the drive'):
            while pilot.phase != phase and not drive.done():
                time.sleep(LOOK)
            marks.append((time.monotonic(), time.process_time(), pilot.state))
    drive.result()
    (t0, casting0, state0), (t1, casting1, state1) = marks
    casting = (casting1 - casting0) / (t1 - t0)
    sending = (state1.processor_s - state0.processor_s) / (t1 - t0)
    rates = [(b - a) / (t1 - t0) for a, b in zip(state0.scans, state1.scans)]
    print(f'{pilot.trip.scene}: {t1 - t0:.1f} s, scans a second '
          f'{" ".join(f"{rate:.2f}" for rate in rates)}, {pilot.starved} left out')
    print(f'share of a core: {casting:.0%} casting + {sending:.0%} sending')
    print(f'lateness of {state1.lateness.count} pieces: {state1.lateness}; real-time priority '
          f'{"yes" if state1.real_time else "not allowed"}')


if __name__ == '__main__':
    main()
