# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Serial ports: opened with plain words for what can go wrong, found again by USB identity."""

from __future__ import annotations

from dataclasses import dataclass
import errno
import grp
import os
from pathlib import Path
import stat
from typing import Any, Protocol

from stri_mapping.errors import LmsError

try:
    import serial
    from serial.tools import list_ports
except ImportError:                 # an installation for recordings alone does without
    serial = None

BUSY = (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK)


class Port(Protocol):
    """What a scanner is behind; `fileno`, `baudrate` and `close` are used where there are any."""

    def read(self, size: int = 1) -> bytes:
        """Return up to so many bytes, none after a time-out."""

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""


@dataclass(frozen=True)
class UsbIdentity:
    """What tells one USB adapter from others, whatever device name it gets."""

    vendor: int
    product: int
    serial_number: str | None
    location: str | None


def open_port(name: str, rate: int = 9600) -> Any:
    """
    Open a port.

    Parameters
    ----------
    name
        Device file, or a URL of pyserial such as socket://host:port or rfc2217://host:port.
    rate
        Line rate in baud to begin with.

    Returns
    -------
    serial.SerialBase
        Eight data bits, no parity, one stop bit, and nobody else may open it.

    Raises
    ------
    LmsError
        Saying in one line what is wrong with the port and what to try.

    """
    if serial is None:
        raise LmsError('pyserial is not installed: pip install pyserial')
    try:
        port = serial.serial_for_url(name, rate, timeout=0.1, do_not_open=True)
        if '://' not in name:
            port.exclusive = True
        port.open()
    except (OSError, ValueError) as error:      # pyserial's errors are OSErrors
        raise LmsError(f'{name}: {_explain(name, error)}') from None
    try:
        port.set_low_latency_mode(True)         # else FTDI adapters hold bytes back for 16 ms
    except (AttributeError, OSError, ValueError, NotImplementedError):
        pass
    return port


def _explain(name: str, error: Exception) -> str:
    """Return why a port did not open, and what to try."""
    number = getattr(error, 'errno', None)
    if '://' in name:
        return f'{_plain(error)}; want socket://HOST:PORT or rfc2217://HOST:PORT, reachable'
    path = Path(name)
    if not path.exists():
        return f'no such port; {_listing()}'
    if number in (errno.EACCES, errno.EPERM):
        owner = _group(path)
        return (f'no permission: it is open to the group {owner}: "sudo usermod -aG {owner} '
                '$USER", then log in again')
    if number in BUSY or 'lock' in str(error):
        return 'in use by another program: end that, or choose another port'
    if not stat.S_ISCHR(path.stat().st_mode):
        return f'neither a serial port nor a capture; {_listing()}'
    if 'Inappropriate ioctl' in str(error):     # pyserial hands the number on in words alone
        return f'it has no line rate; is it a serial port? {_listing()}'
    return f'{_plain(error)}; is it a serial port? {_listing()}'


def _plain(error: Exception) -> str:
    number = getattr(error, 'errno', None)
    return os.strerror(number) if isinstance(number, int) else ' '.join(str(error).split())


def _group(path: Path) -> str:
    number = path.stat().st_gid
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _listing() -> str:
    """Return in words which ports there are."""
    found = [f'{port.device} ({port.description})' for port in list_ports.comports()
             if port.vid is not None or port.hwid != 'n/a']
    return f'ports there: {", ".join(found)}' if found else 'no serial port is plugged in'


def usb_identity(name: str) -> UsbIdentity | None:
    """Return the USB identity of the adapter behind a device file; None if it has none."""
    if serial is None or '://' in name:
        return None
    device = os.path.realpath(name)
    for port in list_ports.comports():
        if port.device == device and port.vid is not None:
            return UsbIdentity(port.vid, port.pid, port.serial_number, port.location)
    return None


def find_again(name: str, identity: UsbIdentity | None) -> str:
    """
    Return the device file that an adapter now has, after it was unplugged and plugged in.

    Where adapters have no serial number, the USB socket that it was plugged into tells.  Without
    identity, or while it is not there, the name is returned as it is.
    """
    if identity is None:
        return name
    for port in list_ports.comports():
        same = (port.vid, port.pid) == (identity.vendor, identity.product)
        if same and (port.serial_number == identity.serial_number if identity.serial_number
                     else port.location == identity.location):
            return str(port.device)
    return name
