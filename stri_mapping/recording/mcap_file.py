# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
One MCAP file in the making.

Why not a library's writer: those close a chunk by its size alone, so that a crash costs what
the last megabyte held, and none survives a full disk.  Here a chunk is closed whenever asked,
and a file is given back whole from a disk without room for one byte more.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
import os
from pathlib import Path
import struct
import zlib

from backports import zstd

from stri_mapping import __version__
from stri_mapping.recording import records

LEVEL = 1                   # of zstd: 5 times smaller than raw scans at 1 % of a core
# Room left beside an index that is written to a full disk: directory and metadata.yaml.
SPARE = 1 << 16


@dataclass(frozen=True)
class Topic:
    """
    What a bag knows of a topic.

    Attributes
    ----------
    name
        With its leading slash.
    type
        Such as sensor_msgs/msg/LaserScan.
    definition
        Text of the message definition and of those it refers to.
    digest
        Its hash, RIHS01_...
    qos
        Offered quality of service: a YAML list.
    encoding
        Of the definition, ros2msg or ros2idl.

    """

    name: str
    type: str
    definition: bytes
    digest: str
    qos: str = '[]'
    encoding: str = 'ros2msg'


@dataclass(frozen=True, slots=True)
class _ClosedChunk:
    """
    What must be remembered of a chunk that is in the file: its place, index and counts.

    There are ten a second, for hours: the counts are packed.
    """

    offset: int
    index: bytes
    packed_counts: bytes
    start_ns: int
    end_ns: int

    @property
    def counts(self) -> Counter[int]:
        """Messages by the number of their channel."""
        return Counter(dict(struct.iter_unpack('<HI', self.packed_counts)))


class McapFile:
    """
    A new MCAP file: messages go in, whole chunks go out.

    Parameters
    ----------
    path
        File to make; it must not exist.

    Attributes
    ----------
    size
        Bytes in the file so far.
    counts
        Messages in the file by topic, those not flushed yet included.
    start_ns, end_ns
        Span of their log times.

    """

    def __init__(self, path: Path) -> None:
        """Make the file."""
        self.path = path
        self.counts: Counter[str] = Counter()
        self.start_ns, self.end_ns = 2**63 - 1, 0
        self._schemas: dict[str, records.Schema] = {}
        self._channels: dict[str, records.Channel] = {}
        self._closed: list[_ClosedChunk] = []
        self._file = path.open('xb', buffering=0)
        self.size = 0
        self._append(records.MAGIC + records.record(
            records.HEADER, records.text('ros2') + records.text(f'stri_mapping {__version__}')))
        self._new_chunk()

    def _new_chunk(self) -> None:
        self._pending: list[bytes] = []
        self.pending_bytes = 0
        self._entries: dict[int, list[tuple[int, int]]] = defaultdict(list)

    def _append(self, data: bytes) -> None:
        """Write all of some bytes, or none: what a full disk took of them is cut off again."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left):]
        except OSError:
            self._truncate(self.size)
            raise
        self.size += len(data)

    def _truncate(self, size: int) -> None:
        self._file.truncate(size)
        self._file.seek(size)

    def write(self, topic: Topic, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add a message to the chunk in the making; it is in the file after `flush`."""
        channel = self._channels.get(topic.name) or self._new_channel(topic)
        self._entries[channel.number].append((log_ns, self.pending_bytes))
        self._add(records.message(records.Message(channel.number, log_ns, publish_ns, data)))
        self.counts[topic.name] += 1
        self.start_ns, self.end_ns = min(self.start_ns, log_ns), max(self.end_ns, log_ns)

    def _add(self, piece: bytes) -> None:
        self._pending.append(piece)
        self.pending_bytes += len(piece)

    def _new_channel(self, topic: Topic) -> records.Channel:
        schema = self._schemas.get(topic.type)
        if schema is None:
            schema = self._schemas[topic.type] = records.Schema(
                len(self._schemas) + 1, topic.type, topic.encoding, topic.definition)
            self._add(records.schema(schema))
        channel = self._channels[topic.name] = records.Channel(
            len(self._channels) + 1, schema.number, topic.name, 'cdr',
            {'offered_qos_profiles': topic.qos, 'topic_type_hash': topic.digest})
        self._add(records.channel(channel))
        return channel

    def flush(self) -> None:
        """
        Close the chunk in the making, if it holds anything; it then outlives this process.

        Raises
        ------
        OSError
            If the file cannot take it.  The chunk is dropped, the file as good as before.

        """
        if not self._entries:
            return
        content, entries = b''.join(self._pending), self._entries
        self._new_chunk()
        times = [log_ns for each in entries.values() for log_ns, _ in each]
        chunk = records.Chunk(min(times), max(times), len(content), zlib.crc32(content), 'zstd',
                              zstd.compress(content, LEVEL), True)
        offset, body = self.size, records.chunk(chunk)
        places, indices = b'', b''
        for number, each in entries.items():
            places += struct.pack('<HQ', number, offset + len(body) + len(indices))
            pairs = b''.join(struct.pack('<QQ', *entry) for entry in each)
            indices += records.record(
                records.MESSAGE_INDEX, struct.pack('<H', number) + records.text(pairs))
        index = struct.pack('<QQQQ', chunk.start_ns, chunk.end_ns, offset, len(body))
        index += records.text(places) + struct.pack('<Q', len(indices)) + records.text('zstd')
        index += struct.pack('<QQ', len(chunk.data), chunk.size)
        counts = Counter({number: len(each) for number, each in entries.items()})
        try:
            self._append(body + indices)
        except OSError:
            self._forget(counts)
            raise
        packed = b''.join(struct.pack('<HI', *each) for each in counts.items())
        self._closed.append(_ClosedChunk(offset, index, packed, chunk.start_ns, chunk.end_ns))

    def _forget(self, counts: Counter[int]) -> None:
        """Take back the counts of a chunk that is not in the file."""
        for channel in self._channels.values():
            self.counts[channel.topic] -= counts[channel.number]
        self.start_ns = min((c.start_ns for c in self._closed), default=2**63 - 1)
        self.end_ns = max((c.end_ns for c in self._closed), default=0)

    def finish(self, metadata: str) -> None:
        """
        Write the index and close the file.

        On a full disk the last chunks make room for it.

        Parameters
        ----------
        metadata
            What rosbag2 keeps in the record of its name: the bag's metadata as YAML.

        Raises
        ------
        OSError
            If the file cannot be completed all the same.

        """
        try:
            try:
                self.flush()
                self._append(self._summary(metadata))
            except OSError:
                self._make_room(metadata)
                self._append(self._summary(metadata))
            os.fsync(self._file.fileno())
        finally:
            self._file.close()

    def _make_room(self, metadata: str) -> None:
        """Cut off chunks from the end until index and metadata.yaml fit in their place."""
        full = self.size
        while self._closed and self.size + len(self._summary(metadata)) + SPARE > full:
            last = self._closed.pop()
            self._truncate(last.offset)
            self.size = last.offset
            self._forget(last.counts)

    def _summary(self, metadata: str) -> bytes:
        """Return everything from the metadata record to the end of the file."""
        note = records.record(records.METADATA, records.text('rosbag2') + records.text_map(
            {'serialized_metadata': metadata}))
        head = note + records.record(records.DATA_END, bytes(4))
        groups = {
            records.SCHEMA: b''.join(map(records.schema, self._schemas.values())),
            records.CHANNEL: b''.join(map(records.channel, self._channels.values())),
            records.STATISTICS: records.record(records.STATISTICS, self._statistics()),
            records.CHUNK_INDEX: b''.join(
                records.record(records.CHUNK_INDEX, chunk.index) for chunk in self._closed),
            records.METADATA_INDEX: records.record(records.METADATA_INDEX, struct.pack(
                '<QQ', self.size, len(note)) + records.text('rosbag2'))}
        start = self.size + len(head)
        body, offsets = b'', b''
        for opcode, group in groups.items():
            if group:
                offsets += records.record(records.SUMMARY_OFFSET, struct.pack(
                    '<BQQ', opcode, start + len(body), len(group)))
            body += group
        footer = struct.pack('<BQQQ', records.FOOTER, 20, start, start + len(body))
        crc = zlib.crc32(body + offsets + footer)
        return head + body + offsets + footer + struct.pack('<I', crc) + records.MAGIC

    def _statistics(self) -> bytes:
        total: Counter[int] = Counter()
        for chunk in self._closed:
            total += chunk.counts
        start_ns, end_ns = (self.start_ns, self.end_ns) if total else (0, 0)
        numbers = struct.pack('<QHIIIIQQ', total.total(), len(self._schemas),
                              len(self._channels), 0, 1, len(self._closed), start_ns, end_ns)
        return numbers + records.text(b''.join(
            struct.pack('<HQ', number, count) for number, count in sorted(total.items())))
