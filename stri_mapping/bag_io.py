# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded scans, mounts and truth from bags: the only module that knows bag formats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
import logging
from pathlib import Path
import sqlite3
import struct
from types import TracebackType
from typing import Any
import zlib

from backports.zstd import ZstdError
import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection, ConnectionExtRosbag1
from rosbags.rosbag1 import ReaderError as Ros1ReaderError
from rosbags.rosbag2 import ReaderError as Ros2ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import get_typestore, Stores, TypesysError

from stri_mapping import geometry
from stri_mapping.errors import BagError
from stri_mapping.scan import Scan, ScanCounts, ScanIntake, stamp_ns
from stri_mapping.trajectory import Trajectory
from stri_mapping.vehicle import remounted, Scanner, Vehicle

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)

LASER_SCAN = 'sensor_msgs/msg/LaserScan'
TRUTH_TOPIC = '/ground_truth/odom'
# What the readers below raise on bytes that are not what they should be.
BROKEN = (AnyReaderError, Ros1ReaderError, Ros2ReaderError, AssertionError, EOFError, KeyError,
          IndexError, ValueError, OSError, UnicodeDecodeError, RuntimeError, struct.error,
          SerdeError, sqlite3.Error, TypesysError, zlib.error, ZstdError)


class Bag:
    """
    A recording opened for reading, as a context manager.

    It may be a rosbag2 directory (MCAP or SQLite, compressed or not), a single .mcap file or a
    ROS 1 .bag file.

    Raises
    ------
    BagError
        On entering, if the path is missing or holds no readable bag.

    """

    def __init__(self, path: Path) -> None:
        """Remember the path; nothing is opened before the context is entered."""
        self.path = path
        self.counts: dict[str, ScanCounts] = {}
        self._reader: AnyReader

    def __enter__(self) -> Bag:
        """Open the bag."""
        if not self.path.exists():
            raise BagError(f'{self.path}: no such file or directory')
        if self.path.is_dir() and not (self.path / 'metadata.yaml').is_file():
            cut = any(self.path.glob('*.mcap'))
            raise BagError(f'{self.path}: not a bag: it holds no metadata.yaml' + (
                ' (if the recording was cut off, run "stri-mapping repair")' if cut else ''))
        try:
            self._reader = AnyReader([self.path],
                                     default_typestore=get_typestore(Stores.ROS2_JAZZY))
            self._reader.open()
        except BROKEN as error:
            raise self._broken(error) from None
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag."""
        self._reader.close()

    def _broken(self, error: BaseException) -> BagError:
        reason = ' '.join(str(error).split()) or type(error).__name__
        return BagError(f'{self.path}: cannot be read as a bag: {reason} (if the recording was '
                        'cut off, try "stri-mapping repair")')

    @property
    def topics(self) -> dict[str, str]:
        """Message type by topic."""
        return {c.topic: c.msgtype for c in self._reader.connections}

    @property
    def scan_topics(self) -> list[str]:
        """Topics that hold LaserScan messages, sorted."""
        return sorted(t for t, kind in self.topics.items() if kind == LASER_SCAN)

    @property
    def start_ns(self) -> int:
        """Log time of the first message, nanoseconds."""
        return int(self._reader.start_time)

    @property
    def duration_ns(self) -> int:
        """Nanoseconds from the first message to the last."""
        return int(self._reader.duration)

    def message_count(self, topic: str) -> int:
        """Return how many messages of a topic the bag states to hold."""
        return sum(c.msgcount for c in self._reader.connections if c.topic == topic)

    def raw_messages(
        self, topics: Sequence[str] | None = None,
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """
        Iterate over (connection, log time in ns, bytes) in the order of recording.

        Raises
        ------
        BagError
            If the bag turns out to be broken part way.

        """
        chosen = [c for c in self._reader.connections if topics is None or c.topic in topics]
        try:
            yield from self._reader.messages(chosen) if chosen else ()
        except BROKEN as error:
            raise self._broken(error) from None

    def cdr_messages(self, topics: Sequence[str]) -> Iterator[tuple[Connection, int, bytes]]:
        """Iterate like `raw_messages`, but over the bytes of ROS 2 also for a ROS 1 bag."""
        store = get_typestore(Stores.ROS2_JAZZY)
        for connection, log_ns, data in self.raw_messages(topics):
            if isinstance(connection.ext, ConnectionExtRosbag1):
                try:
                    message = self._reader.deserialize(data, connection.msgtype)
                    data = bytes(store.serialize_cdr(message, connection.msgtype))
                except BROKEN as error:
                    raise self._broken(error) from None
            yield connection, log_ns, data

    def messages(self, topics: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
        """Iterate over (topic, log time in ns, message) in the order of recording."""
        for connection, log_ns, data in self.raw_messages(topics):
            try:
                message = self._reader.deserialize(data, connection.msgtype)
            except BROKEN as error:
                raise self._broken(error) from None
            yield connection.topic, log_ns, message

    def scans(self, scanners: Sequence[Scanner]) -> Iterator[tuple[Scanner, Scan]]:
        """
        Iterate over the scans of some scanners in the order of recording.

        Malformed scans and scans whose stamp does not come after the one before it on their
        topic are left out and counted in `counts`; so are, but not left out, scans without
        any return.

        """
        by_topic = {s.topic: s for s in scanners}
        intakes = {s.topic: ScanIntake(s.topic) for s in scanners}
        self.counts = {s.name: intakes[s.topic].counts for s in scanners}
        for topic, _, message in self.messages(list(by_topic)):
            scan = intakes[topic].take(message)
            if scan is not None:
                yield by_topic[topic], scan

    def static_transforms(self) -> dict[tuple[str, str], Array]:
        """Return the 4x4 transforms of /tf_static by (parent frame, child frame)."""
        found: dict[tuple[str, str], Array] = {}
        for _, _, message in self.messages(['/tf_static']):
            for stamped in message.transforms:
                t, q = stamped.transform.translation, stamped.transform.rotation
                matrix = np.eye(4)
                matrix[:3, 3] = (t.x, t.y, t.z)
                try:
                    matrix[:3, :3] = geometry.rotation_from_quat((q.x, q.y, q.z, q.w))
                except ValueError as error:
                    raise BagError(f'{self.path}: /tf_static to "{stamped.child_frame_id}": '
                                   f'{error}') from None
                key = (stamped.header.frame_id.lstrip('/'), stamped.child_frame_id.lstrip('/'))
                found[key] = matrix
        return found

    def frame_of(self, topic: str) -> str:
        """Return the frame id of the first scan on a topic; empty where there is none."""
        for _, _, message in self.messages([topic]):
            return str(message.header.frame_id).lstrip('/')
        return ''

    def odometry(self, topic: str) -> Trajectory:
        """
        Return the poses of a nav_msgs/Odometry topic, in the plane.

        Raises
        ------
        BagError
            If the topic is not in the bag or holds something else.

        """
        if self.topics.get(topic) != 'nav_msgs/msg/Odometry':
            raise BagError(f'{self.path}: no nav_msgs/msg/Odometry on {topic}; '
                           f'topics there: {self.listing}')
        stamps, rows = [], []
        for _, _, message in self.messages([topic]):
            p, q = message.pose.pose.position, message.pose.pose.orientation
            stamps.append(stamp_ns(message.header.stamp))
            rows.append([p.x, p.y, float(geometry.yaw_from_quat((q.x, q.y, q.z, q.w)))])
        order, first = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
        poses = np.array(rows).reshape(-1, 3)[first]
        poses[:, 2] = np.unwrap(poses[:, 2])
        return Trajectory(order, poses)

    @property
    def listing(self) -> str:
        """The topics there are, with their types, for error messages."""
        return ', '.join(f'{t} ({kind})' for t, kind in sorted(self.topics.items())) or 'none'

    def require_scans(self, topic: str) -> None:
        """Raise BagError, listing the topics there are, unless a topic holds LaserScans."""
        if topic not in self.topics:
            raise BagError(f'{self.path}: no topic {topic}; topics there: {self.listing}')
        if self.topics[topic] != LASER_SCAN:
            raise BagError(f'{self.path}: {topic} holds {self.topics[topic]}, want {LASER_SCAN}')
        if self.message_count(topic) == 0:
            raise BagError(f'{self.path}: {topic} holds no message')


def select_scanners(
    bag: Bag, vehicle: Vehicle, horizontal: str | None = None,
    verticals: Sequence[str] | None = None,
) -> Vehicle:
    """
    Return the scanners whose scans a bag holds, with their topics and mounts as recorded.

    Topics come from the command line where given, else from the vehicle.  Mounts come from
    /tf_static (base_link to the scans' frame) where it has them, else from the vehicle; a
    difference of more than 1 cm or 0.5 degrees is said.

    Parameters
    ----------
    bag
        An open bag.
    vehicle
        The vehicle description.
    horizontal, verticals
        Topics that replace the vehicle's.  With `horizontal` alone no vertical scanner of the
        vehicle is asked for, but those whose topics are there are used.

    Raises
    ------
    BagError
        If the bag has no scans, or not on the topic of the horizontal scanner, or not on a
        topic that was named, or a scanner named on the command line has no known mount.

    """
    if not bag.scan_topics:
        raise BagError(f'{bag.path}: holds no {LASER_SCAN}; topics there: {bag.listing}')
    mounts = bag.static_transforms()
    wanted = [replace(vehicle.horizontal, topic=horizontal or _resolve(bag, vehicle.horizontal))]
    if verticals is None:
        wanted += [replace(s, topic=_resolve(bag, s)) for s in vehicle.verticals
                   if _resolve(bag, s) in bag.topics]
    else:
        known = {_resolve(bag, s): s for s in vehicle.verticals}
        wanted += [replace(known[t], topic=t) if t in known else _unknown_vertical(t)
                   for t in verticals]
    for scanner in wanted:
        bag.require_scans(scanner.topic)
    return Vehicle(tuple(_recorded_mount(bag, s, mounts) for s in wanted))


def _resolve(bag: Bag, scanner: Scanner) -> str:
    """Return the scanner's topic as this bag spells it: relative names match under '/'."""
    return scanner.topic if scanner.topic in bag.topics else '/' + scanner.topic.lstrip('/')


def _unknown_vertical(topic: str) -> Scanner:
    name = topic.strip('/').removesuffix('/scan').replace('/', '_')
    return Scanner(name, 'vertical', np.full((4, 4), np.nan), '', topic)


def _recorded_mount(
    bag: Bag, scanner: Scanner, mounts: dict[tuple[str, str], Array],
) -> Scanner:
    frame = bag.frame_of(scanner.topic)
    recorded = mounts.get(('base_link', frame))
    if recorded is None:
        if not np.all(np.isfinite(scanner.T_base_laser)):
            raise BagError(f'{scanner.topic}: its mount is neither in /tf_static (base_link to '
                           f'"{frame}") nor in the vehicle file')
        if frame != scanner.frame:
            logger.warning('%s: frame "%s" is not in /tf_static; the mount of "%s" is taken from '
                           'the vehicle file', scanner.topic, frame, scanner.name)
        return replace(scanner, frame=frame)
    return remounted(scanner, frame, recorded)
