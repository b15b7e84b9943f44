# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The records of an MCAP file, to bytes and back.

The format is the one of https://mcap.dev/spec: a magic number, records of an opcode, a length
and that many bytes, and the magic number again.  Everything is little-endian.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import struct
from typing import NamedTuple

MAGIC = b'\x89MCAP0\r\n'
(HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX) = range(1, 9)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(0x0b, 0x10)
_PREFIX = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<HIQQ')
_CHUNK = struct.Struct('<QQQI')


class Chunk(NamedTuple):
    """A compressed run of schemas, channels and messages."""

    start_ns: int
    end_ns: int
    size: int               # of the records, uncompressed
    crc: int                # of the records, uncompressed; 0 where none was made
    compression: str
    data: bytes             # what there is of the compressed records
    complete: bool


class Message(NamedTuple):
    """One serialised message."""

    channel: int
    log_ns: int
    publish_ns: int
    data: bytes


class Schema(NamedTuple):
    """A message type and its definition."""

    number: int
    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
    """A topic."""

    number: int
    schema: int
    topic: str
    encoding: str
    metadata: dict[str, str]


def record(opcode: int, content: bytes) -> bytes:
    """Return one record."""
    return _PREFIX.pack(opcode, len(content)) + content


def text(value: str | bytes) -> bytes:
    """Return a string as the format has it: its length before it."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack('<I', len(data)) + data


def text_map(values: Mapping[str, str]) -> bytes:
    """Return a map of strings."""
    return text(b''.join(text(key) + text(value) for key, value in values.items()))


def schema(value: Schema) -> bytes:
    """Return the record of a schema."""
    return record(SCHEMA, struct.pack('<H', value.number) + text(value.name)
                  + text(value.encoding) + text(value.data))


def channel(value: Channel) -> bytes:
    """Return the record of a channel."""
    return record(CHANNEL, struct.pack('<HH', value.number, value.schema) + text(value.topic)
                  + text(value.encoding) + text_map(value.metadata))


def message(value: Message) -> bytes:
    """Return the record of a message."""
    return record(MESSAGE, _MESSAGE.pack(value.channel, 0, value.log_ns, value.publish_ns)
                  + value.data)


def chunk(value: Chunk) -> bytes:
    """Return the record of a chunk."""
    return record(CHUNK, _CHUNK.pack(value.start_ns, value.end_ns, value.size, value.crc)
                  + text(value.compression) + struct.pack('<Q', len(value.data)) + value.data)


def split(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Iterate over opcode and content of the whole records in a run of them."""
    at = 0
    while at + _PREFIX.size <= len(data):
        opcode, length = _PREFIX.unpack_from(data, at)
        at += _PREFIX.size
        if at + length > len(data):
            return
        yield opcode, data[at:at + length]
        at += length


class _Fields:
    """Takes a record's content apart, from its front."""

    def __init__(self, content: bytes) -> None:
        self._rest = content

    def numbers(self, form: str) -> tuple[int, ...]:
        size = struct.calcsize('<' + form)
        head, self._rest = self._rest[:size], self._rest[size:]
        return struct.unpack('<' + form, head)

    def data(self) -> bytes:
        length, = self.numbers('I')
        head, self._rest = self._rest[:length], self._rest[length:]
        return head

    def text(self) -> str:
        return self.data().decode()

    def text_map(self) -> dict[str, str]:
        inner = _Fields(self.data())
        found = {}
        while inner._rest:
            key = inner.text()
            found[key] = inner.text()
        return found


def read_schema(content: bytes) -> Schema:
    """Return the schema of a record; struct.error or UnicodeDecodeError where it is broken."""
    fields = _Fields(content)
    number, = fields.numbers('H')
    return Schema(number, fields.text(), fields.text(), fields.data())


def read_channel(content: bytes) -> Channel:
    """Return the channel of a record; struct.error or UnicodeDecodeError where it is broken."""
    fields = _Fields(content)
    number, of = fields.numbers('HH')
    return Channel(number, of, fields.text(), fields.text(), fields.text_map())


def read_message(content: bytes) -> Message:
    """Return the message of a record; struct.error where it is broken."""
    number, _, log_ns, publish_ns = _MESSAGE.unpack_from(content)
    return Message(number, log_ns, publish_ns, content[_MESSAGE.size:])


def read_chunk(content: bytes) -> Chunk:
    """Return the chunk of a record, also of one cut off; struct.error if nothing can be told."""
    fields = _Fields(content)
    start_ns, end_ns, size, crc = fields.numbers('QQQI')
    compression = fields.text()
    length, = fields.numbers('Q')
    data = fields._rest[:length]
    return Chunk(start_ns, end_ns, size, crc, compression, data, len(data) == length)
