# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping simulate`: a virtual drive, with ground truth, as a bag."""

from __future__ import annotations

import argparse
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

from stri_mapping.errors import BagError, UsageError

if TYPE_CHECKING:
    from stri_mapping.simulation.drive import Drive


def add_parser(subparsers: Any) -> None:
    """Declare the command and its options."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'simulate', help='a virtual drive, with ground truth, as a bag',
        description='Drive a virtual vehicle through a street and write what its scanners send.')
    parser.add_argument('scene', metavar='SCENE', help='name of the scene; "list" names them all')
    parser.add_argument('--output', type=Path, metavar='BAG', help='directory to make')
    parser.add_argument('--seed', type=int, default=1, metavar='N',
                        help='draws everything random (1)')
    parser.add_argument('--duration', type=float, metavar='S',
                        help="seconds; the scene's own by default")
    parser.add_argument('--vehicle', type=Path, metavar='F',
                        help='vehicle description (the one that came with the package)')
    parser.add_argument('--variant', default='180x1', metavar='V',
                        help='scanner type and setting (180x1): field x resolution in degrees')
    parser.add_argument('--vibration', type=float, default=1.0, metavar='X',
                        help='scale of roll, pitch and heave: 1 an ordinary car, 0 none (1)')
    parser.add_argument('--traffic', type=float, default=1.0, metavar='X',
                        help='how much moves in the street: 1 an ordinary one, 0 nothing (1)')
    parser.add_argument('--slope', type=float, default=0.0, metavar='X',
                        help='percent by which the ground rises along the way (0)')
    parser.add_argument('--crossfall', type=float, default=0.0, metavar='X',
                        help='percent by which it rises to the left (0)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate and write; return the exit code."""
    from stri_mapping.vehicle import load_vehicle
    try:
        from stri_mapping.simulation import drive, lms, scenes
    except ImportError as error:
        raise UsageError(f'the package "{error.name}" is missing: '
                         "pip install 'stri_mapping[simulation]'") from None
    if args.scene == 'list':
        print('\n'.join(f'{name:10} {make.__doc__}' for name, make in scenes.SCENES.items()))
        return 0
    if args.output is None:
        raise UsageError('--output is missing: name a directory to make')
    if args.output.exists():
        raise BagError(f'{args.output}: exists already; name a new directory')
    options = scenes.Options(args.seed, args.duration, args.vibration, args.traffic, args.slope,
                             args.crossfall)
    vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
    _record(drive.make_drive(args.scene, options, lms.variant(args.variant), vehicle), args.output)
    return 0


def _record(virtual: Drive, output: Path) -> None:
    """Write the drive with a progress bar, and say what was written."""
    from rich.console import Console
    from rich.progress import Progress

    from stri_mapping.simulation.record import record
    began, duration = time.perf_counter(), virtual.scene.duration
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(f'driving {virtual.scene.name}', total=duration)
        scans = record(virtual, output, lambda done: bar.update(task, completed=done))
    took = time.perf_counter() - began
    size = sum(f.stat().st_size for f in output.iterdir())
    print(f'{output}: {scans} scans of {duration:.1f} s, {size / 1e6:.1f} MB, '
          f'made in {took:.1f} s ({duration / took:.1f} times real time)')
