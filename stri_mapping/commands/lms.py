# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping lms`: look at one SICK LMS 2xx without ROS."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
import logging
import math
from pathlib import Path
import signal
import sys
import time
from typing import Any, TYPE_CHECKING

from stri_mapping.errors import UsageError

if TYPE_CHECKING:
    from stri_mapping.lms.driver import Driver
    from stri_mapping.lms.identity import Identity
    from stri_mapping.lms.settings import LmsSettings
    from stri_mapping.lms.stamps import TimedScan

# The plot: columns, the metres of its highest bar, and pictures a second on a terminal.
COLUMNS, FULL_SCALE, PICTURES = 60, 20.0, 10.0
BARS = ' ▁▂▃▄▅▆▇█'


def add_parser(subparsers: Any) -> None:
    """Describe the command and what it consists of."""
    from stri_mapping.lms_emulator.command import add_parser as add_emulator

    parser = subparsers.add_parser(
        'lms', help='look at a SICK LMS 2xx scanner',
        description='Look at one SICK LMS 2xx scanner without ROS. PORT is a device file, a URL '
        'such as socket://host:port or rfc2217://host:port, or a capture.')
    actions = parser.add_subparsers(dest='action', metavar='ACTION', required=True)
    info = actions.add_parser('info', help='find the scanner; print who it is and how it is set')
    stream = actions.add_parser('stream', help='show its scans as they come')
    capture = actions.add_parser('capture', help='save its bytes with their arrival times')
    for each in (info, stream, capture):
        each.add_argument('port', metavar='PORT')
    stream.add_argument('--rates', action='store_true', help='print figures instead of a plot')
    capture.add_argument('file', type=Path, metavar='FILE')
    for each in (stream, capture):
        _add_settings(each)
    for each, run in ((info, run_info), (stream, run_stream), (capture, run_capture)):
        each.set_defaults(run=run)
    add_emulator(actions)


def _add_settings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--duration', type=float, default=math.inf, metavar='S',
                        help='seconds after which to end (default: at Ctrl-C)')
    parser.add_argument('--baud', dest='serial_baud', type=int, default=38400, metavar='BD',
                        help='line rate to stream at: up to 38400 on RS-232, 500000 on RS-422 '
                        '(default: %(default)s)')
    parser.add_argument('--stream', default='turns', metavar='KIND',
                        help='turns, scans or remission (default: %(default)s)')
    parser.add_argument('--resolution', type=float, default=1.0, metavar='DEG',
                        help='1, 0.5 or 0.25 degrees (default: %(default)s)')
    parser.add_argument('--scan-angle', type=int, default=180, metavar='DEG',
                        help='180 or 100 degrees (default: %(default)s)')


def settings(args: argparse.Namespace) -> LmsSettings:
    """Return the settings that the arguments stand for; the configuration is left as it is."""
    from stri_mapping.lms.settings import LmsSettings

    given = {field.name: getattr(args, field.name) for field in fields(LmsSettings)
             if hasattr(args, field.name)}
    return LmsSettings(**given, serial_port=args.port, real_time_index=False)


@contextmanager
def connected(args: argparse.Namespace) -> Iterator[Driver]:
    """Give the driver of a scanner that was found; in the end it is left silent, at 9600 Bd."""
    from stri_mapping.lms.driver import Driver

    if not args.duration > 0.0:
        raise UsageError(f'--duration is {args.duration:g}: want a positive number of seconds')
    logging.getLogger('stri_mapping').setLevel(logging.INFO)
    driver = Driver(settings(args))
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        driver.connect()
        driver.start()
        yield driver
    finally:
        driver.leave()
        signal.signal(signal.SIGTERM, previous)


def run_info(args: argparse.Namespace) -> int:
    """Find the scanner at any rate, and print who it is and how it is set; change nothing."""
    from stri_mapping.lms.device import Device
    from stri_mapping.lms.driver import open_line
    from stri_mapping.lms.requests import RATES

    line = open_line(args.port)
    try:
        device = Device(line)
        for name, value in description(device.identity(device.find(tuple(RATES))), line.rate):
            print(f'{name:<20}{value}')
    finally:
        line.close()
    return 0


def description(identity: Identity, rate: int) -> Iterator[tuple[str, str]]:
    """Return names and values of what a scanner tells of itself."""
    from stri_mapping.lms.measuring import MODES
    from stri_mapping.lms.status import describe_status

    status, configuration = identity.status, identity.configuration
    yield 'type', identity.type_text.strip(' \0')
    yield 'firmware', f'{status.firmware.strip()}, boot PROM {status.boot_prom.strip()}'
    yield 'serial number', status.serial_number.strip()
    yield 'line rate', f'{rate} Bd' + ', kept at power-on' * bool(status.keeps_rate)
    yield 'variant', f'{status.angle} deg at {0.01 * status.resolution:g} deg'
    yield 'mirror turn', f'{status.turn_ms:.2f} ms (75.08 Hz is 13.32 ms)'
    yield 'window pollution', f'{100.0 * status.window_pollution:.0f} %'
    yield 'laser power', f'{status.laser_power} % of calibration'
    mode = MODES.get(configuration.measuring_mode)
    reach = f', ranges to {mode.range_max(configuration.unit):.4g} m' if mode else ''
    yield 'measuring mode', f'0x{configuration.measuring_mode:02X}{reach}'
    yield 'unit', {0: 'cm', 1: 'mm'}.get(configuration.unit, f'{configuration.unit} (reserved)')
    yield 'real-time indices', 'on' if configuration.indices else 'off'
    yield 'configuration', configuration.block.hex(' ')
    yield 'status byte', describe_status(status.status)
    yield 'fault memory', '; '.join(identity.errors.texts) or 'empty'


def run_stream(args: argparse.Namespace) -> int:
    """Show scans until the time is over, or Ctrl-C."""
    from stri_mapping.lms.capture import CaptureEndError

    try:
        _show(args)
    except CaptureEndError as end:
        print(end)
    return 0


def _show(args: argparse.Namespace) -> None:
    with connected(args) as driver:
        end, shown, count = time.monotonic() + args.duration, time.monotonic(), 0
        pause = 1.0 if args.rates or not sys.stdout.isatty() else 1.0 / PICTURES
        while (now := time.monotonic()) < end:
            scans = driver.scans(0.1)
            count += len(scans)
            if scans and now - shown >= pause:
                text = figures(driver) if args.rates else picture(scans[-1])
                print(f'{text}  {count / (now - shown):5.2f} Hz',
                      end='\n' if pause == 1.0 else '\r', flush=True)
                shown, count = now, 0


def figures(driver: Driver) -> str:
    """Return what came and what was lost, in one line."""
    clock, counts = driver.stamper.clock, driver.counts
    return (f'{driver.stamper.dated} scans, {driver.stamper.lost} lost, '
            f'{counts.crc_errors} CRC errors, {counts.noise_bytes} bytes of noise, '
            f'jitter {clock.arrival_jitter.rms * 1e-6:.3f} ms, after the fit '
            f'{clock.fit_jitter.rms * 1e-6:.3f} ms')


def picture(timed: TimedScan) -> str:
    """Return one scan as bars from left to right, the highest one `FULL_SCALE` metres."""
    import numpy as np

    nearest = [np.nanmin(part, initial=np.inf) for part in
               np.array_split(timed.scan.ranges[::-1], COLUMNS)]
    bars = ''.join(BARS[round(min(r / FULL_SCALE, 1.0) * (len(BARS) - 1))] for r in nearest)
    return f'|{bars}| nearest {min(nearest):6.2f} m'


def run_capture(args: argparse.Namespace) -> int:
    """Save what the scanner sends until the time is over, or Ctrl-C."""
    from stri_mapping.lms.capture import CaptureWriter

    with connected(args) as driver:
        assert driver.identity is not None and driver.stream is not None
        writer = CaptureWriter(args.file, driver.identity, driver.stream.request)
        driver.listen(writer.write)
        end = time.monotonic() + args.duration
        try:
            while time.monotonic() < end:
                driver.scans(0.1)
        finally:
            driver.listen(None)
            writer.close()
            print(f'{args.file}: {driver.stamper.dated} scans, {writer.bytes} bytes')
    return 0
