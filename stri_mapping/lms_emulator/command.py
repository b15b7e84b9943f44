# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping lms emulate`: a scanner for those who have none."""

from __future__ import annotations

import argparse
from pathlib import Path
import signal
import time
from typing import Any, TYPE_CHECKING

from stri_mapping.errors import UsageError

if TYPE_CHECKING:
    from stri_mapping.lms_emulator.device import EmulatedLms


def add_parser(subparsers: Any) -> None:
    """Describe the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        'emulate', help='a scanner without hardware, behind a pseudo terminal',
        description='Emulate a scanner, byte for byte and at true times, until Ctrl-C. Open the '
        'link as the serial port of anything that talks to an LMS 2xx.')
    parser.add_argument('--link', type=Path, required=True, metavar='PATH',
                        help='symbolic link to make, to be used as the serial port')
    parser.add_argument('--model', default='LMS291', metavar='TYPE',
                        help='type of the scanner (default: %(default)s)')
    parser.add_argument('--rate', type=int, default=9600, metavar='BD',
                        help='line rate it is found at (default: %(default)s)')
    parser.add_argument('--streaming', action='store_true',
                        help='it is found streaming, as a killed driver leaves it')
    parser.add_argument('--ppm', type=float, default=30.0, metavar='X',
                        help='how much too slowly its mirror turns, parts per million '
                        '(default: %(default)s)')
    parser.add_argument('--start', type=float, default=10.0, metavar='S',
                        help='seconds from power-on or reset until it is ready '
                        '(default: %(default)s)')
    parser.add_argument('--faults', type=Path, metavar='FILE',
                        help='what goes wrong, YAML or JSON: a list by the name of the link')
    parser.add_argument('--seed', type=int, default=0, metavar='N',
                        help='draws noise and faults (default: %(default)s)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Emulate until SIGINT or SIGTERM, then say what happened."""
    from stri_mapping.lms_emulator.ports import Ports, PtyPort

    device = make_device(args, time.monotonic())
    ports = Ports((PtyPort(args.link, device),))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ports.stop())
    print(f'{args.link}: {device.memory.model.text.strip()} at {device.memory.rate} Bd; '
          'Ctrl-C ends it', flush=True)
    try:
        ports.run()
    finally:
        ports.close()
    print(f'{device.counts.requests} requests, {device.counts.scans} scans; '
          f'bytes were late by {ports.lateness.figures}')
    return 0


def make_device(args: argparse.Namespace, begin: float) -> EmulatedLms:
    """
    Return the scanner that is asked for.

    Raises
    ------
    UsageError
        If a value is out of range or the plan of faults is malformed.

    """
    from stri_mapping.lms_emulator.device import EmulatedLms
    from stri_mapping.lms_emulator.faults import read_plans
    from stri_mapping.lms_emulator.model import make_memory
    from stri_mapping.lms_emulator.replies import Timing
    from stri_mapping.lms_emulator.room import Room
    from stri_mapping.lms_emulator.turns import Mirror
    from stri_mapping.scan import MIRROR_TURN

    if abs(args.ppm) > 1e4:
        raise UsageError(f'--ppm is {args.ppm:g}: want -10000 to 10000')
    if not 0.0 <= args.start <= 600.0:
        raise UsageError(f'--start is {args.start:g}: want 0 to 600 s')
    plans = {} if args.faults is None else read_plans(args.faults)
    memory = make_memory(args.model, args.rate, args.streaming)
    return EmulatedLms(
        Room(args.seed), memory, mirror=Mirror(begin, MIRROR_TURN * (1.0 + 1e-6 * args.ppm)),
        timing=Timing(start=args.start), faults=plans.get(args.link.name, ()), begin=begin,
        seed=args.seed)
