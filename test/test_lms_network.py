# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Scanners behind network gateways: raw sockets, and RFC 2217 with its own line rate."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import select
import socket
import threading
import time

from lms_rig import Numbered, Rig
import numpy as np
import pytest
import serial
from serial.rfc2217 import PortManager

from stri_mapping.lms.driver import Driver
from stri_mapping.lms.requests import ON_REQUEST
from stri_mapping.lms.settings import LmsSettings
from stri_mapping.lms_emulator.device import EmulatedLms
from stri_mapping.lms_emulator.model import make_memory
from stri_mapping.lms_emulator.ports import Ports, PtyPort
from stri_mapping.lms_emulator.turns import Mirror


class Pty(serial.Serial):
    """A serial port without the modem lines that a pty lacks."""

    cts = dsr = ri = cd = True

    def _update_rts_state(self) -> None:
        pass

    def _update_dtr_state(self) -> None:
        pass


class Gateway(threading.Thread):
    """One serial port on the network."""

    def __init__(self, path: Path, rate: int, rfc2217: bool) -> None:
        super().__init__(daemon=True)
        self._server = socket.create_server(('127.0.0.1', 0))
        self.number = self._server.getsockname()[1]
        self._port, self._rfc2217 = Pty(str(path), rate, timeout=0), rfc2217

    def run(self) -> None:
        host, _ = self._server.accept()
        host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        manager = PortManager(self._port, Writer(host)) if self._rfc2217 else None
        with host, self._port, self._server:
            while True:
                ready, _, _ = select.select([host, self._port.fd], [], [], 0.05)
                if host in ready:
                    data = host.recv(4096)
                    if not data:
                        return
                    self._port.write(b''.join(manager.filter(data)) if manager else data)
                if self._port.fd in ready:
                    data = os.read(self._port.fd, 4096)
                    host.sendall(b''.join(manager.escape(data)) if manager else data)


class Writer:
    """What the protocol's own messages to the host go through."""

    def __init__(self, host: socket.socket) -> None:
        self.write = host.sendall


@contextmanager
def behind_gateway(folder: Path, rate: int, rfc2217: bool) -> Iterator[tuple[EmulatedLms, int]]:
    begin = time.monotonic()
    device = EmulatedLms(Numbered(), make_memory('LMS291', rate), begin=begin,
                         mirror=Mirror(begin, 13.32e-3))
    with Ports((PtyPort(folder / 'lms', device),)):
        gateway = Gateway(folder / 'lms', rate, rfc2217)
        gateway.start()
        yield device, gateway.number
        gateway.join(10.0)


@pytest.mark.parametrize('kind, rate, wanted, left', [
    ('socket', 500000, 500000, 500000),     # the gateway's rate is not the driver's to change
    ('rfc2217', 9600, 38400, 9600),
    ('rfc2217', 38400, 500000, 9600)])
def test_a_scanner_behind_a_gateway(tmp_path, kind, rate, wanted, left):
    with behind_gateway(tmp_path, rate, kind == 'rfc2217') as (device, number):
        driver = Driver(LmsSettings(serial_port=f'{kind}://127.0.0.1:{number}',
                                    serial_baud=wanted))
        driver.connect()
        assert device.memory.rate == wanted
        driver.start()
        rig = Rig(device, None, driver)
        while len(rig.got) < 15:
            rig.got += [(time.monotonic(), scan) for scan in driver.scans(0.1)]
        driver.leave()
    assert (device.memory.mode, device.memory.rate) == (ON_REQUEST, left)
    assert len(set(rig.turns())) == len(rig.got)
    assert np.max(np.abs(rig.stamp_errors())) < 20e-3
