# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Figures of the LMS driver: parsing, stamps, recovery from faults, load and take-over.

    python benchmarks/lms_driver.py [parse] [stamps] [faults] [nodes]
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / 'test'))

import live
from lms_rig import inject, Numbered, PPM, rigs, wait

from stri_mapping.lms.answers import decode_answer
from stri_mapping.lms.measuring import measuring_mode
from stri_mapping.lms.models import identify
from stri_mapping.lms.parser import Parser, Received
from stri_mapping.lms.samples import Indices, Samples, Scan
from stri_mapping.lms.stamps import Stamper
from stri_mapping.lms.stream import make_stream, Stream
from stri_mapping.lms.telegram import frame
from stri_mapping.lms_emulator.device import EmulatedLms
from stri_mapping.lms_emulator.faults import Fault
from stri_mapping.lms_emulator.model import Memory, OUTDOOR
from stri_mapping.lms_emulator.turns import Mirror, Variant

LMS291 = identify('LMS291;S05063;V02.10')
TELEGRAMS = 6000


def parse() -> None:
    """Whole telegrams of 361 values from bytes to ranges with stamps, in reads of 64 bytes."""
    stream, generator = make_stream(LMS291, 'scans', 180, 50), np.random.default_rng(0)
    words = generator.integers(0, 8000, 361).astype('<u2').tobytes()
    data = b''.join(frame(Scan(Samples(words), Indices(2 * k % 256, k % 256)).encode(), 0x80)
                    for k in range(TELEGRAMS))
    arrival_step = 26.64e6 * TELEGRAMS / len(data)
    parser, stamper, began, count = Parser(), Stamper(), time.process_time(), 0
    stamper.restart(2)
    for at in range(0, len(data), 64):
        for item in parser.feed(data[at:at + 64], round(at * arrival_step)):
            count += dated(stamper, stream, item) is not None
    took = time.process_time() - began
    print(f'parse: {TELEGRAMS / took:.0f} telegrams of 361 values a second of one core, '
          f'ranges and stamps included ({count} dated)')


def dated(stamper: Stamper, stream: Stream, item: object) -> int | None:
    """Return the steady nanoseconds of a telegram's first ray."""
    assert isinstance(item, Received)
    scan = stream.measured(decode_answer(item.telegram.payload), measuring_mode(0))
    assert scan is not None
    timed = stamper.date(scan, stream, item.begin_ns, False)
    return None if timed is None else timed.stamp_ns - stamper.host_offset


def stamps() -> None:
    """Ten minutes of an emulated scanner in its own time: 5 ms of jitter, bursts of 16 ms."""
    for indices in (True, False):
        stream, period = make_stream(LMS291, 'turns', 180, 100), 13.32e-3 * (1.0 + 1e-6 * PPM)
        device = EmulatedLms(
            Numbered(), Memory(rate=500000, mode=0x2A, variant=Variant(180, 100),
                               configuration=OUTDOOR.changed(indices=indices)),
            mirror=Mirror(0.0, period), faults=[Fault('jitter', duration=1e6, share=0.3)])
        parser, stamper, errors = Parser(), Stamper(), []
        parser.byte_ns = 20_000
        while (due := device.next_due) < 600.0:
            for arrival in device.arrivals(due, 500000):
                for item in parser.feed(arrival.data, round(1e9 * arrival.due)):
                    ray = dated(stamper, stream, item)
                    if ray is not None:
                        turns = 1e-9 * ray / period
                        errors.append((due, (turns - round(turns)) * period))
        at, error = np.array(errors).T
        for begin, end in ((5.0, 600.0), (5.0, 60.0), (540.0, 600.0)):
            chosen = error[(at >= begin) & (at < end)]
            print(f'stamps {"with" if indices else "without"} indices, {begin:.0f} to {end:.0f} '
                  f's: rms {1e3 * np.sqrt(np.mean(chosen**2)):.3f} ms, mean '
                  f'{1e3 * chosen.mean():+.3f}, max {1e3 * np.abs(chosen).max():.3f}; lost '
                  f'{stamper.lost}')


def faults() -> None:
    """Seconds from each fault's end (of a start: from the scanner being ready) to scans."""
    kinds = ('crc', 'drop', 'insert', 'cut', 'silence', 'nak', 'miss', 'unplug', 'reset',
             'power_cycle')
    for kind in kinds:
        with tempfile.TemporaryDirectory() as folder, rigs(
                Path(folder), {'lms': ()}) as (ports, made):
            rig = made['lms']
            for _ in range(5 if kind in ('silence', 'unplug', 'reset', 'power_cycle') else 1):
                seen = len(rig.got)
                wait(lambda rig=rig, seen=seen: len(rig.got) > seen + 40, 'scans')
                over = inject(ports, rig, Fault(kind, duration=1.37, share=0.5))
                wait(lambda rig=rig, over=over: rig.since(over), 'scans')
                print(f'{kind}: scans {rig.since(over):.2f} s after its end', flush=True)


def nodes() -> None:
    """Four driver processes on four emulated scanners: load, and take-over after kill -9."""
    from sensor_msgs.msg import LaserScan

    import stri_mapping.nodes  # noqa: F401  with it the listener is found as soon as a node is

    with tempfile.TemporaryDirectory() as folder, live.listener() as (node, executor, env):
        paths = [Path(folder) / f'lms{k}' for k in range(4)]
        got: list[float] = []
        node.create_subscription(LaserScan, f'/{paths[0].name}/scan', lambda m: got.append(
            m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec), live.lossless())
        emulators = [subprocess.Popen(
            [sys.executable, '-m', 'stri_mapping.cli', 'lms', 'emulate', '--link', str(path),
             '--rate', '500000', '--streaming'], stdout=subprocess.DEVNULL) for path in paths]
        live.wait_until(lambda: all(path.exists() for path in paths), 'the emulators')
        drivers = [driver(path, env) for path in paths]
        spin(executor, lambda: len(got) > 400)
        before, began = sum(map(seconds, drivers)), time.monotonic()
        spin(executor, lambda: time.monotonic() > began + 20.0)
        share = (sum(map(seconds, drivers)) - before) / (time.monotonic() - began)
        print(f'nodes: four drivers at 75 Hz, 181 values: {100.0 * share:.1f} % of one core')
        for _ in range(5):
            drivers[0].kill()
            drivers[0].wait()
            start = time.time()
            drivers[0] = driver(paths[0], env)
            spin(executor, lambda start=start: got[-1] > start)
            print(f'take-over: first scan measured {got[-1] - start:.2f} s, received '
                  f'{time.time() - start:.2f} s after the start of the process', flush=True)
            spin(executor, lambda count=len(got): len(got) > count + 50)
        for process in drivers:
            process.send_signal(signal.SIGINT)
            process.wait()
        for process in emulators:
            process.send_signal(signal.SIGINT)
            process.wait()


def spin(executor: Any, condition: Callable[[], bool]) -> None:
    """Take messages as fast as they come until a condition holds."""
    while not condition():
        executor.spin_once(timeout_sec=0.05)


def driver(path: Path, env: dict[str, str]) -> subprocess.Popen[bytes]:
    """Start a driver node."""
    return subprocess.Popen(
        [sys.executable, '-m', 'stri_mapping.nodes.sick_lms_driver', '--ros-args', '-r',
         f'__ns:=/{path.name}', '-p', f'serial_port:={path}', '-p', 'self_start:=true'],
        env=env, stderr=subprocess.DEVNULL)


def seconds(process: subprocess.Popen[bytes]) -> float:
    """Return the processor time that a process has used."""
    fields = Path(f'/proc/{process.pid}/stat').read_text(encoding='utf-8').split()
    return (int(fields[13]) + int(fields[14])) / 100.0


if __name__ == '__main__':
    sections = {'parse': parse, 'stamps': stamps, 'faults': faults, 'nodes': nodes}
    for chosen in sys.argv[1:] or sections:
        sections[chosen]()
