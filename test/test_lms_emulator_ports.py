# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Emulated scanners behind real pseudo terminals."""

from __future__ import annotations

import argparse
from contextlib import contextmanager
import os
from pathlib import Path
import select
import signal
import subprocess
import sys
import termios
import time
import tty

import live
import pytest

from stri_mapping.errors import LmsError
from stri_mapping.lms import requests
from stri_mapping.lms.parser import Parser, Received
from stri_mapping.lms.requests import Request, SwitchMode
from stri_mapping.lms.samples import Scan
from stri_mapping.lms.telegram import frame
from stri_mapping.lms_emulator import command
from stri_mapping.lms_emulator.device import EmulatedLms
from stri_mapping.lms_emulator.faults import Fault
from stri_mapping.lms_emulator.model import make_memory
from stri_mapping.lms_emulator.ports import Ports, PtyPort
from stri_mapping.lms_emulator.replies import Timing
from stri_mapping.lms_emulator.room import Room

RATES = {9600: termios.B9600, 38400: termios.B38400, 500000: termios.B500000}


class Host:
    """A program that has a serial port open, with nothing but the system's calls."""

    def __init__(self, path: Path, rate: int) -> None:
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.fd)
        self.set_rate(rate)
        self.parser = Parser()

    def set_rate(self, rate: int) -> None:
        mode = termios.tcgetattr(self.fd)
        mode[4] = mode[5] = RATES[rate]
        termios.tcsetattr(self.fd, termios.TCSANOW, mode)

    def read(self, wait: float = 0.1) -> bytes:
        return os.read(self.fd, 4096) if select.select([self.fd], [], [], wait)[0] else b''

    def ask(self, request: Request) -> bytes:
        """Return the payload of the next answer that is no scan."""
        os.write(self.fd, frame(request.encode()))
        found: list[bytes] = []
        live.wait_until(lambda: found.extend(p for p in self.payloads() if p[0] != 0xB0) or found,
                        f'an answer to {request}')
        return found[0]

    def payloads(self) -> list[bytes]:
        data = self.read()
        # an answer that has cut a scan lies inside what the scan's header promised
        found = self.parser.feed(data, 0) if data else self.parser.idle()
        return [item.telegram.payload for item in found if isinstance(item, Received)]

    def close(self) -> None:
        os.close(self.fd)


@contextmanager
def emulated(path: Path, *faults: Fault, rate: int = 9600):
    """Give a scanner behind a port, and the host that has it open."""
    begin = time.monotonic()
    device = EmulatedLms(Room(), make_memory('LMS291', rate), begin=begin, faults=faults,
                         timing=Timing(start=0.3))
    with Ports((PtyPort(path, device),)) as ports:
        host = Host(path, rate)
        try:
            yield ports, device, host
        finally:
            host.close()


def test_a_host_talks_to_it_at_the_rates_it_sets(tmp_path):
    with emulated(tmp_path / 'lms') as (ports, device, host):
        assert host.ask(requests.ReadType())[1:7] == b'LMS291'
        assert host.ask(SwitchMode(requests.RATES[500000])) == b'\xA0\x00\x10'
        live.wait_until(lambda: device.memory.rate == 500000, 'the new rate')
        host.set_rate(500000)
        assert host.ask(SwitchMode(requests.EVERY_TURN)) == b'\xA0\x00\x10'
        scans: list[bytes] = []
        live.wait_until(lambda: scans.extend(host.payloads()) or len(scans) > 30, 'scans')
        assert {p[0] for p in scans} == {0xB0}
        assert host.ask(SwitchMode(requests.ON_REQUEST)) == b'\xA0\x00\x10'
        assert not device.streaming
        assert ports.lateness.count > 30


def test_the_wrong_rate_gets_no_answer(tmp_path):
    with emulated(tmp_path / 'lms', rate=38400) as (_, device, host):
        assert host.ask(requests.ReadType())[0] == 0xBA
        host.set_rate(9600)
        os.write(host.fd, frame(requests.ReadType().encode()))
        # until an answer would have been there for long
        assert host.read(0.3) == b''
        assert device.counts.requests == 1


def test_who_opens_the_port_next_finds_nothing_old(tmp_path):
    with emulated(tmp_path / 'lms', rate=500000) as (ports, device, host):
        device.memory.configuration = device.memory.configuration.changed(indices=True)
        host.ask(SwitchMode(requests.ALL_VALUES))
        live.wait_until(lambda: ports.lateness.count > 100, 'bytes that the host leaves unread')
        host.close()
        live.wait_until(lambda: not ports.ports[0].opened, 'the port to be closed')
        sent = device.counts.scans
        live.wait_until(lambda: device.counts.scans > sent + 5, 'scans that nobody hears')
        turn = device.mirror.next_turn(time.monotonic())
        host.fd = os.open(tmp_path / 'lms', os.O_RDWR | os.O_NOCTTY)
        host.set_rate(500000)
        first = Scan.decode(first_payloads(host)[0])
        # a scan is under way for two turns and waits for another
        assert (first.indices.turn - (turn - 4)) % 256 < 128


def first_payloads(host: Host) -> list[bytes]:
    found: list[bytes] = []
    live.wait_until(lambda: found.extend(host.payloads()) or found, 'a scan')
    return found


@pytest.mark.parametrize('kind', ['unplug', 'power_cycle'])
def test_a_device_that_vanishes_and_returns_has_its_link_renewed(tmp_path, kind):
    path = tmp_path / 'lms'
    with emulated(path, rate=38400) as (ports, device, host):
        assert host.ask(requests.ReadType())[0] == 0xBA
        ports.post(lambda: device.inject(Fault(kind, duration=0.3), time.monotonic()))
        live.wait_until(lambda: not path.is_symlink(), 'the link to vanish')
        assert gone(host)
        live.wait_until(path.exists, 'the link to come back')
        host.close()
        host.fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        if kind == 'unplug':
            host.set_rate(38400)
            assert host.ask(requests.ReadType())[0] == 0xBA
        else:
            host.set_rate(9600)
            assert first_payloads(host)[0][0] == 0x90


def gone(host: Host) -> bool:
    """Read until the terminal has hung up."""
    try:
        while os.read(host.fd, 4096):
            pass
    except OSError:
        pass
    return True


def test_a_file_in_the_links_place_is_not_replaced_and_no_link_stays(tmp_path):
    path = tmp_path / 'lms'
    path.write_text('mine')
    with pytest.raises(LmsError, match='is there already and no link'):
        Ports((PtyPort(path, EmulatedLms(Room())),))
    assert path.read_text() == 'mine'
    with pytest.raises(LmsError, match='no link can be made: No such file'):
        Ports((PtyPort(tmp_path / 'none' / 'lms', EmulatedLms(Room())),))
    with emulated(tmp_path / 'other'):
        assert (tmp_path / 'other').is_symlink()
    assert not (tmp_path / 'other').is_symlink()


def test_a_link_that_another_emulator_has_taken_over_stays(tmp_path):
    path = tmp_path / 'lms'
    old = PtyPort(path, EmulatedLms(Room()))
    new = PtyPort(path, EmulatedLms(Room()))
    old.plug()
    new.plug()
    old.unplug()
    assert path.exists()
    new.unplug()
    assert not path.is_symlink()


def arguments(*given: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    command.add_parser(parser.add_subparsers())
    return parser.parse_args(['emulate', *given])


def test_the_command_emulates_until_interrupted(tmp_path):
    path = tmp_path / 'lms'
    process = subprocess.Popen(
        [sys.executable, '-m', 'stri_mapping.cli', 'lms', 'emulate', '--link', str(path),
         '--rate', '500000', '--streaming'], stdout=subprocess.PIPE, text=True)
    try:
        live.wait_until(path.exists, 'the link')
        host = Host(path, 500000)
        assert first_payloads(host)[0][0] == 0xB0
        host.close()
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=live.TIMEOUT)
    finally:
        process.kill()
    assert process.returncode == 0
    assert 'LMS291;S05063;V02.10 at 500000 Bd' in output
    assert '0 requests' in output
    assert not path.is_symlink()


def test_the_command_takes_type_and_faults(tmp_path):
    plan = tmp_path / 'plan.yaml'
    plan.write_text('lms: [{kind: unplug, at: 1.0}]\n')
    device = command.make_device(arguments(
        '--link', str(tmp_path / 'lms'), '--model', 'LMS291-S14', '--streaming', '--faults',
        str(plan)), 0.0)
    assert device.streaming and device.memory.model.fast
    assert not device.present(1.5)
