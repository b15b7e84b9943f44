# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping lms`: what a user with a scanner sees, and what one without sees."""

from __future__ import annotations

import os
from pathlib import Path
import pty
import signal
import subprocess
import sys
import time

import live
from lms_rig import Numbered

from stri_mapping import cli
from stri_mapping.lms import port
from stri_mapping.lms.requests import ON_REQUEST
from stri_mapping.lms_emulator.device import EmulatedLms
from stri_mapping.lms_emulator.model import make_memory
from stri_mapping.lms_emulator.ports import Ports, PtyPort


def emulated(path: Path):
    return live.command('lms', 'emulate', '--link', path, '--rate', 38400,
                        env=dict(os.environ))


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, '-m', 'stri_mapping.cli', 'lms', *map(str, arguments)],
                          capture_output=True, text=True, check=False, timeout=60.0)


def test_info_stream_capture_and_replay(tmp_path):
    path, capture = tmp_path / 'lms', tmp_path / 'street.lms'
    with emulated(path) as emulator:
        live.wait_until(path.exists, 'the port')
        info = run('info', path)
        assert info.returncode == 0, info.stderr
        for line in ('type                LMS291;S05063;V02.10', 'serial number       00000001',
                     'line rate           38400 Bd', 'variant             180 deg at 0.5 deg',
                     'ranges to 81.83 m', 'unit                cm', 'fault memory        empty'):
            assert line in info.stdout
        done = run('capture', path, capture, '--duration', 1.3, '--baud', 500000)
        assert done.returncode == 0, done.stderr
        assert f'{capture}: ' in done.stdout
        again = run('capture', path, capture)
        assert again.returncode == 1 and f'{capture}: cannot be made: File exists' in again.stderr
        stream = run('stream', path, '--rates', '--duration', 1.6)
        assert stream.returncode == 0, stream.stderr
        assert ' 0 lost, 0 CRC errors' in stream.stdout and 'Hz' in stream.stdout
        emulator.send_signal(signal.SIGINT)
        assert emulator.wait(60.0) == 0
    replay = run('stream', capture, '--baud', 500000)
    assert replay.returncode == 0, replay.stderr
    assert '|' in replay.stdout and 'nearest' in replay.stdout
    assert 'the capture has ended' in replay.stdout
    assert 'serial number       00000001' in run('info', capture).stdout
    other = run('stream', capture, '--stream', 'scans')
    assert other.returncode == 1
    assert 'the capture holds the stream' in other.stderr
    refused = run('stream', capture, '--resolution', 0.25)
    assert (refused.returncode, refused.stderr.count('Traceback')) == (1, 0)


def test_ctrl_c_leaves_the_scanner_waiting(tmp_path):
    device = EmulatedLms(Numbered(), make_memory('LMS291'), begin=time.monotonic())
    with Ports((PtyPort(tmp_path / 'lms', device),)):
        for number in (signal.SIGINT, signal.SIGTERM):
            with live.command('lms', 'stream', tmp_path / 'lms', '--rates',
                              env=dict(os.environ)) as process:
                assert any(' 0 lost' in line for line in process.stdout)
                process.send_signal(number)
                assert process.wait(60.0) == 130
            assert (device.memory.mode, device.memory.rate) == (ON_REQUEST, 9600)


def said(capsys, *arguments: str) -> str:
    """Return the one line that a command fails with."""
    assert cli.main(['lms', *arguments]) in (1, 2)
    error = capsys.readouterr().err
    assert error.count('\n') == 1
    return error


def test_a_port_that_is_not_there_is_one_line_with_those_that_are(capsys, tmp_path):
    text = said(capsys, 'info', '/dev/ttyUSB77')
    assert '/dev/ttyUSB77: no such port' in text
    assert 'ports there: ' in text or 'no serial port is plugged in' in text
    (tmp_path / 'file').write_text('something')
    assert 'neither a serial port nor a capture' in said(capsys, 'info', str(tmp_path / 'file'))
    assert 'is it a serial port?' in said(capsys, 'info', '/dev/null')
    assert 'want socket://HOST:PORT' in said(capsys, 'info', 'socket://127.0.0.1:1')
    assert 'want socket://HOST:PORT' in said(capsys, 'info', 'sockt://127.0.0.1:1')


def test_a_port_without_permission_names_the_group(capsys, tmp_path, monkeypatch):
    (tmp_path / 'tty').touch()

    class Denied:
        def open(self) -> None:
            raise PermissionError(13, 'Permission denied')

    monkeypatch.setattr(port.serial, 'serial_for_url', lambda *args, **kwargs: Denied())
    text = said(capsys, 'info', str(tmp_path / 'tty'))
    assert 'no permission: it is open to the group' in text
    assert 'usermod -aG' in text


def test_a_port_that_is_in_use_says_so(capsys):
    _, slave = pty.openpty()
    holder = port.open_port(os.ttyname(slave))
    assert 'in use by another program' in said(capsys, 'info', os.ttyname(slave))
    holder.close()


def test_a_port_with_something_else_on_it_is_one_line(capsys):
    _, slave = pty.openpty()
    text = said(capsys, 'info', os.ttyname(slave))
    assert 'no LMS 2xx answers at 9600, 19200, 38400, 500000 Bd: is it powered' in text


def test_wrong_arguments_are_one_line(capsys):
    assert 'serial_baud is 4800: want one of 9600' in said(
        capsys, 'stream', '/dev/null', '--baud', '4800')
    assert '--duration is -1' in said(capsys, 'stream', '/dev/null', '--duration', '-1')


def test_an_adapter_is_found_again_by_its_usb_identity(monkeypatch):
    from serial.tools.list_ports_common import ListPortInfo

    def plugged(device: str, serial_number: str | None, location: str) -> ListPortInfo:
        info = ListPortInfo(device)
        info.vid, info.pid, info.serial_number, info.location = (
            0x0403, 0x6001, serial_number, location)
        return info

    ports = [plugged('/dev/ttyUSB0', 'A1', '1-1'), plugged('/dev/ttyUSB1', None, '1-2')]
    monkeypatch.setattr(port.list_ports, 'comports', lambda: ports)
    with_number, without = port.usb_identity('/dev/ttyUSB0'), port.usb_identity('/dev/ttyUSB1')
    ports[:] = [plugged('/dev/ttyUSB5', None, '1-2'), plugged('/dev/ttyUSB6', 'A1', '3-1')]
    assert port.find_again('/dev/ttyUSB0', with_number) == '/dev/ttyUSB6'
    assert port.find_again('/dev/ttyUSB1', without) == '/dev/ttyUSB5'
    ports.clear()
    assert port.find_again('/dev/ttyUSB0', with_number) == '/dev/ttyUSB0'
    assert port.usb_identity('/dev/ttyUSB0') is None
    assert port.usb_identity('socket://host:1') is None
