# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Captures: the bytes of a streaming scanner with their arrival times, and their replay as a port.

A capture is the line ``CAPTURE``, one line of JSON (the payloads of the request that started
the stream, and of the answers that tell who the scanner is and how it is set), and records:
arrival in nanoseconds since the first one (8 bytes), number of bytes (4), bytes; little endian.
"""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path
import struct
import time
from typing import Any, BinaryIO

from stri_mapping.errors import LmsError
from stri_mapping.lms.answers import (
    Answer,
    ConfigurationRead,
    ConfigurationWritten,
    ModeAnswer,
    Refused,
    TypeAnswer,
    VariantAnswer,
)
from stri_mapping.lms.identity import Identity
from stri_mapping.lms.parser import Parser, Received
from stri_mapping.lms.requests import (
    ALL_VALUES,
    decode_request,
    EVERY_TURN,
    PAIRS,
    ReadConfiguration,
    ReadErrors,
    ReadStatus,
    ReadType,
    REMISSION,
    Request,
    SetVariant,
    SUB_RANGE,
    SwitchMode,
    WriteConfiguration,
)
from stri_mapping.lms.telegram import ACK, ANSWER, frame

CAPTURE = b'stri_mapping LMS capture 1\n'
RECORD = struct.Struct('<QI')
STREAMS = (ALL_VALUES, EVERY_TURN, SUB_RANGE, PAIRS, REMISSION)


class CaptureEndError(LmsError):
    """A capture has been replayed to its end."""


class CaptureWriter:
    """
    Writes a capture.

    Parameters
    ----------
    path
        File to write, which must not be there yet.
    identity
        Who the scanner is.
    request
        What has started the stream.

    """

    def __init__(self, path: Path, identity: Identity, request: SwitchMode) -> None:
        """Write the head."""
        answers: dict[str, Answer] = {
            'type': TypeAnswer(identity.type_text), 'status': identity.status,
            'configuration': ConfigurationRead(identity.configuration), 'errors': identity.errors}
        head: dict[str, Any] = {name: answer.encode().hex() for name, answer in answers.items()}
        head['stream'] = request.encode().hex()
        try:
            self._file: BinaryIO = path.open('xb')
        except OSError as error:
            raise LmsError(f'{path}: cannot be made: {error.strerror}') from None
        self._file.write(CAPTURE + json.dumps(head).encode('ascii') + b'\n')
        self._begin: int | None = None
        self.bytes = 0

    def write(self, data: bytes, now_ns: int) -> None:
        """Add what one read returned, and when."""
        if self._begin is None:
            self._begin = now_ns
        self._file.write(RECORD.pack(now_ns - self._begin, len(data)) + data)
        self.bytes += len(data)

    def close(self) -> None:
        """Write what is left."""
        self._file.close()


class Capture:
    """
    A capture as a port: a scanner that tells who it is, and streams at the capture's own times.

    It can do only what it did when it was recorded; anything else it refuses.

    Parameters
    ----------
    path
        A file that begins with `CAPTURE`.

    Raises
    ------
    LmsError
        If the head is damaged.

    """

    def __init__(self, path: Path) -> None:
        """Read the head."""
        self.path = path
        self.timeout: float | None = 0.1
        self._file = path.open('rb')
        self._file.readline()
        try:
            head = json.loads(self._file.readline())
            self._stream = decode_request(bytes.fromhex(head['stream']))
            self._answers: dict[type[Request], bytes] = {
                kind: bytes.fromhex(head[name]) for kind, name in (
                    (ReadType, 'type'), (ReadStatus, 'status'),
                    (ReadConfiguration, 'configuration'), (ReadErrors, 'errors'))}
        except (ValueError, KeyError, TypeError) as error:
            raise LmsError(f'{path}: the head of this capture is damaged ({error})') from None
        self._requests = Parser(answers=False)
        self._out = bytearray()
        self._records: Iterator[tuple[int, bytes]] = iter(())
        self._next: tuple[int, bytes] | None = None     # arrival on our clock, bytes
        self._begin = 0
        self._streaming = False

    def write(self, data: bytes) -> int:
        """Take in what the host sends; answers are there at once."""
        for item in self._requests.feed(data, 0):
            if isinstance(item, Received):
                self._out += bytes((ACK,)) + frame(
                    self._answer(decode_request(item.telegram.payload)), ANSWER)
        return len(data)

    def _answer(self, request: Request) -> bytes:
        if type(request) in self._answers:
            return self._answers[type(request)]
        if isinstance(request, SwitchMode):
            wanted = request.mode in STREAMS
            if wanted and request != self._stream:
                raise LmsError(f'{self.path}: the capture holds the stream {self._stream}, and '
                               f'not {request}')
            self._streaming = wanted
            if wanted:
                self._begin = time.monotonic_ns()
                self._records = read_records(self._file)
                self._next = next(self._records, None)
            return ModeAnswer().encode()
        if isinstance(request, SetVariant):
            return VariantAnswer(0, 0, 0).encode()
        if isinstance(request, WriteConfiguration):
            block = self._answers[ReadConfiguration]
            return ConfigurationWritten(0, ConfigurationRead.decode(block).configuration).encode()
        return Refused().encode()

    def read(self, size: int = 1) -> bytes:
        """Return bytes that have come by now, waiting for the first up to `timeout`."""
        if not self._out:
            self._fill(time.monotonic_ns() + round(1e9 * (self.timeout or 0.0)))
        data = bytes(self._out[:size])
        del self._out[:size]
        return data

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting."""
        return len(self._out)

    def _fill(self, until_ns: int) -> None:
        """Take what comes next, waiting for it no longer than to a time."""
        due = until_ns
        if self._streaming:
            if self._next is None:
                self._streaming = False
                raise CaptureEndError(f'{self.path}: the capture has ended')
            due = min(due, self._begin + self._next[0])
        time.sleep(max(due - time.monotonic_ns(), 0) * 1e-9)
        if self._streaming and self._next is not None and self._begin + self._next[0] <= due:
            self._out += self._next[1]
            self._next = next(self._records, None)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def open_capture(path: Path) -> Capture | None:
    """Return a capture as a port; None if the file is something else."""
    try:
        if not path.is_file():
            return None
        with path.open('rb') as file:
            if file.read(len(CAPTURE)) != CAPTURE:
                return None
    except OSError:                     # which of the port's own errors it is, its opening tells
        return None
    return Capture(path)


def read_records(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Return the records from the present place on; one that is cut short ends them."""
    while len(head := file.read(RECORD.size)) == RECORD.size:
        arrival, size = RECORD.unpack(head)
        data = file.read(size)
        if len(data) < size:
            return
        yield arrival, data
