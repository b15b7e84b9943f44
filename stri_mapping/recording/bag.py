# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 directory in the making: files split by size or time, and metadata.yaml."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
import os
from pathlib import Path
import shutil
from typing import Any, NamedTuple

import yaml

from stri_mapping.errors import BagError, StriMappingError
from stri_mapping.recording.mcap_file import McapFile, Topic

METADATA_NAME = 'metadata.yaml'
VERSION = 9
# What a full disk means: this share of it left, or this many bytes, whichever is less.
FREE_SHARE, FREE_BYTES = 0.05, 500_000_000


class DiskFullError(StriMappingError):
    """Too little room is left to record on; what was recorded is complete."""


class FileFacts(NamedTuple):
    """What metadata.yaml says of one file."""

    name: str
    start_ns: int
    end_ns: int
    counts: Counter[str]


def facts(file: McapFile) -> FileFacts:
    """Return what metadata.yaml says of a file."""
    return FileFacts(file.path.name, file.start_ns, file.end_ns, +file.counts)


def metadata(topics: Mapping[str, Topic], files: Sequence[FileFacts]) -> dict[str, Any]:
    """Return what rosbag2 calls a bag's metadata, its version 9, of all files of a bag."""
    counts = sum((each.counts for each in files), Counter[str]())
    start_ns = min((each.start_ns for each in files if each.counts), default=0)
    end_ns = max((each.end_ns for each in files if each.counts), default=0)
    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': end_ns - start_ns},
        'starting_time': {'nanoseconds_since_epoch': start_ns},
        'message_count': counts.total(),
        'topics_with_message_count': [
            {'topic_metadata': {
                'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
                'offered_qos_profiles': yaml.safe_load(topic.qos) or [],
                'type_description_hash': topic.digest},
             'message_count': counts[name]}
            for name, topic in topics.items()],
        'compression_format': '', 'compression_mode': '',
        'relative_file_paths': [each.name for each in files],
        'files': [
            {'path': each.name,
             'starting_time': {'nanoseconds_since_epoch': each.start_ns if each.counts else 0},
             'duration': {'nanoseconds': each.end_ns - each.start_ns if each.counts else 0},
             'message_count': each.counts.total()} for each in files],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }


def write_metadata(
    folder: Path, topics: Mapping[str, Topic], files: Sequence[FileFacts],
) -> None:
    """Write metadata.yaml; it is there whole or not at all."""
    part = folder / f'{METADATA_NAME}.part'
    content = {'rosbag2_bagfile_information': metadata(topics, files)}
    part.write_text(yaml.safe_dump(content, sort_keys=False), encoding='utf-8')
    os.replace(part, folder / METADATA_NAME)


def metadata_text(topics: Mapping[str, Topic], files: Sequence[FileFacts]) -> str:
    """Return the metadata as it stands in an MCAP file itself."""
    return str(yaml.safe_dump(metadata(topics, files), sort_keys=False))


class Recording:
    """
    A bag being recorded.

    While it is being written it has no metadata.yaml, by which a bag that was cut off is known.

    Parameters
    ----------
    folder
        Directory of the bag, new unless an earlier part of it is continued.
    split_bytes
        Size at which a new file is begun; 0 for never.
    split_ns
        Span of log time at which a new file is begun; 0 for never.
    first
        Number of the first file; with more than 0 the directory holds the earlier ones, and
        the bag is to be completed by a repair after `close`.

    Raises
    ------
    BagError
        If the directory exists already or cannot be made.

    """

    def __init__(
        self, folder: Path, split_bytes: int = 0, split_ns: int = 0, first: int = 0,
    ) -> None:
        """Make the directory and its first file."""
        self.folder = folder
        self._split_bytes, self._split_ns = split_bytes, split_ns
        self._first = first
        self._topics: dict[str, Topic] = {}
        self._files: list[FileFacts] = []
        try:
            folder.mkdir(parents=True, exist_ok=first > 0)
            self._file = self._next_file()
        except FileExistsError:
            raise BagError(f'{folder}: exists already; name a new directory') from None
        except OSError as error:
            raise BagError(f'{folder}: cannot be made: {error.strerror}') from None

    def _next_file(self) -> McapFile:
        number = self._first + len(self._files)
        return McapFile(self.folder / f'{self.folder.name}_{number}.mcap')

    @property
    def count(self) -> int:
        """Messages recorded so far."""
        return sum((each.counts.total() for each in self._files), self._file.counts.total())

    @property
    def size(self) -> int:
        """Bytes of the file being written."""
        return self._file.size

    def write(self, topic: Topic, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add a message; it outlives this process once `flush` has been called."""
        if self._full(log_ns):
            try:
                self._close_file()
                self._file = self._next_file()
            except OSError as error:
                raise DiskFullError(
                    f'{self.folder}: {error.strerror}; recording stopped') from None
        self._topics.setdefault(topic.name, topic)
        self._file.write(topic, log_ns, publish_ns, data)

    def _full(self, log_ns: int) -> bool:
        span = log_ns - self._file.start_ns
        size = self._file.size + self._file.pending_bytes
        return bool(0 < self._split_bytes <= size or 0 < self._split_ns <= span)

    def flush(self) -> None:
        """
        Hand all messages to the system.

        Raises
        ------
        DiskFullError
            If too little room is left for more; what was flushed before is in the bag.

        """
        free = shutil.disk_usage(self.folder)
        if free.free < min(FREE_BYTES, FREE_SHARE * free.total):
            raise DiskFullError(f'{self.folder}: only {free.free / 1e6:.1f} MB are left on the '
                                'disk; recording stopped')
        try:
            self._file.flush()
        except OSError as error:
            raise DiskFullError(f'{self.folder}: {error.strerror}; recording stopped') from None

    def _close_file(self) -> None:
        self._file.finish(metadata_text(self._topics, [*self._files, facts(self._file)]))
        self._files.append(facts(self._file))

    def close(self) -> None:
        """
        Complete the bag.

        Raises
        ------
        BagError
            If the disk does not take it; `stri-mapping repair` completes it then.

        """
        try:
            self._close_file()
            write_metadata(self.folder, self._topics, self._files)
        except OSError as error:
            raise BagError(f'{self.folder}: cannot be completed: {error.strerror}; make room, '
                           f'then run "stri-mapping repair {self.folder}"') from None
