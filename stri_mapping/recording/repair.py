# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Bags that a crash cut off: every whole message is found again, and the bag is completed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
import os
from pathlib import Path
import re
import struct
from typing import BinaryIO
import zlib

from backports import zstd

from stri_mapping.errors import BagError
from stri_mapping.recording import records
from stri_mapping.recording.bag import facts, FileFacts, metadata_text, write_metadata
from stri_mapping.recording.mcap_file import McapFile, Topic

# Bytes of messages in one chunk of a file written anew.
CHUNK_BYTES = 1 << 20
DAMAGED = '.damaged'
FOOTER = struct.Struct('<QQI')
Found = tuple[Topic, records.Message]


@dataclass
class Repair:
    """
    What a repair did.

    Attributes
    ----------
    messages
        In the bag as it is now.
    mended
        Names of the files that had to be written anew.
    unreadable
        Bytes that gave no message, in all of them.

    """

    messages: int = 0
    mended: list[str] = field(default_factory=list)
    unreadable: int = 0


def repair(path: Path) -> Repair:
    """
    Make a bag readable again, in its place.

    Files that are whole stay as they are.  One that is not is written anew with every message
    that can be read, and kept beside it under its name with ".damaged" added.  metadata.yaml is
    made of what is there.

    Parameters
    ----------
    path
        A bag's directory, or a single .mcap file.

    Raises
    ------
    BagError
        If there is no MCAP file, or one cannot be written.

    """
    files = mcap_files(path)
    done, topics, about = Repair(), dict[str, Topic](), list[FileFacts]()
    try:
        for file in files:
            content = Salvage(file)
            fact = content.count(topics)
            if not content.whole:
                fact = _write_anew(content, topics, about)
                done.mended.append(file.name)
                done.unreadable += content.unreadable
            done.messages += fact.counts.total()
            about.append(fact)
        if path.is_dir():
            write_metadata(path, topics, about)
    except OSError as error:
        raise BagError(f'{error.filename or path}: {error.strerror}') from None
    return done


def mcap_files(path: Path) -> list[Path]:
    """Return the MCAP files of a bag in the order of recording; BagError if there are none."""
    if not path.exists():
        raise BagError(f'{path}: no such file or directory')
    files = [path] if path.is_file() else sorted(path.glob('*.mcap'), key=_place)
    files = [file for file in files if file.suffix == '.mcap']
    if not files:
        raise BagError(f'{path}: holds no .mcap file; only such recordings can be repaired')
    return files


def _place(path: Path) -> tuple[int, str]:
    """Return the number that a split bag's file has at the end of its name, and the name."""
    number = re.search(r'_(\d+)$', path.stem)
    return (int(number[1]) if number else 0, path.name)


def _write_anew(content: Salvage, topics: dict[str, Topic], before: list[FileFacts]) -> FileFacts:
    """Write the messages of a damaged file to a new one that takes its place."""
    path = content.path
    part = path.with_name(path.name + '.part')
    part.unlink(missing_ok=True)
    new = McapFile(part)
    for topic, message in content.messages():
        new.write(topic, message.log_ns, message.publish_ns, message.data)
        if new.pending_bytes > CHUNK_BYTES:
            new.flush()
    fact = facts(new)._replace(name=path.name)
    new.finish(metadata_text(topics, [*before, fact]))
    os.replace(path, path.with_name(path.name + DAMAGED))
    os.replace(part, path)
    return fact


def _ends_well(file: BinaryIO) -> bool:
    """Return whether a file ends as it should, with an index that bears its checksum."""
    ending = len(records.record(records.FOOTER, bytes(FOOTER.size)) + records.MAGIC)
    size = os.fstat(file.fileno()).st_size
    file.seek(max(size - ending, 0))
    end = file.read()
    if len(end) < ending or end[0] != records.FOOTER or not end.endswith(records.MAGIC):
        return False
    start, _, crc = FOOTER.unpack(end[9:9 + FOOTER.size])
    if crc == 0 or not 0 < start < size:        # none was made
        return bool(crc == 0)
    file.seek(start)
    summary = file.read()[:-len(records.MAGIC) - 4]
    return bool(zlib.crc32(summary) == crc)


class Salvage:
    """
    Reads what an MCAP file holds, from front to back, whole or not.

    Attributes
    ----------
    whole
        After reading: whether the file ends as it should and nothing in it was unreadable.
    unreadable
        After reading: bytes that gave no message.

    Raises
    ------
    BagError
        While reading, if it is no MCAP file.

    """

    def __init__(self, path: Path) -> None:
        """Remember the file."""
        self.path = path
        self.whole, self.unreadable = False, 0
        self._schemas: dict[int, records.Schema] = {}
        self._topics: dict[int, Topic] = {}

    def count(self, topics: dict[str, Topic]) -> FileFacts:
        """Read everything; add the topics to those given, and return what was met."""
        counts: Counter[str] = Counter()
        start_ns, end_ns = 2**63 - 1, 0
        for topic, message in self.messages():
            topics.setdefault(topic.name, topic)
            counts[topic.name] += 1
            start_ns = min(start_ns, message.log_ns)
            end_ns = max(end_ns, message.log_ns)
        return FileFacts(self.path.name, start_ns, end_ns, counts)

    def messages(self) -> Iterator[Found]:
        """Iterate over every message that can be read, with its topic."""
        self.whole, self.unreadable = False, 0
        with self.path.open('rb') as file:
            if file.read(len(records.MAGIC)) != records.MAGIC:
                raise BagError(f'{self.path}: not an MCAP file')
            ended = False
            for opcode, content in self._records(file):
                ended = ended or opcode == records.DATA_END
                if not ended:           # what follows repeats what was there
                    yield from self._open(opcode, content)
            self.whole = ended and not self.unreadable and _ends_well(file)

    def _records(self, file: BinaryIO) -> Iterator[tuple[int, bytes]]:
        """Iterate over the records, the last one cut off where the file is."""
        size = os.fstat(file.fileno()).st_size
        while len(head := file.read(9)) == 9 and head != records.MAGIC:
            opcode, length = struct.unpack('<BQ', head)
            left = size - file.tell()
            content = file.read(min(length, left))
            if len(content) < length and opcode != records.CHUNK:
                self.unreadable += len(content)
                return
            yield opcode, content
            if opcode == records.FOOTER:
                return

    def _open(self, opcode: int, content: bytes) -> Iterator[Found]:
        """Iterate over the messages of one record; what is broken in it is left out."""
        try:
            if opcode == records.SCHEMA:
                schema = records.read_schema(content)
                self._schemas[schema.number] = schema
            elif opcode == records.CHANNEL:
                self._note(records.read_channel(content))
            elif opcode == records.MESSAGE:
                message = records.read_message(content)
                yield self._topics[message.channel], message
            elif opcode == records.CHUNK:
                for inner, part in records.split(self._unpacked(records.read_chunk(content))):
                    yield from self._open(inner, part)
        except (struct.error, UnicodeDecodeError, KeyError, zstd.ZstdError):
            self.unreadable += len(content)

    def _unpacked(self, chunk: records.Chunk) -> bytes:
        """Return the records of a chunk, as many as came through."""
        if chunk.compression == 'zstd':
            data = zstd.ZstdDecompressor().decompress(chunk.data)
        elif chunk.compression == 'lz4':
            import lz4.frame
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data)
        else:
            data = chunk.data
        if not chunk.complete or (chunk.crc and zlib.crc32(data) != chunk.crc):
            self.unreadable += max(chunk.size - len(data), 1)
        return data

    def _note(self, channel: records.Channel) -> None:
        schema = self._schemas[channel.schema]
        self._topics[channel.number] = Topic(
            channel.topic, schema.name, schema.data,
            channel.metadata.get('topic_type_hash', ''),
            channel.metadata.get('offered_qos_profiles', '[]'), schema.encoding)
