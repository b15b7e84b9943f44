# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Write scans, mounts and truth to a rosbag2 directory, with no ROS installed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import get_typestore, Stores

from stri_mapping import geometry
from stri_mapping.errors import BagError
from stri_mapping.scan import MIRROR_TURN, Scan
from stri_mapping.vehicle import Scanner

Array = NDArray[np.float64]
_FOREVER = QosTime(2147483647, 4294967295)


def _qos(durability: QosDurability, depth: int) -> Qos:
    return Qos(QosHistory.KEEP_LAST, depth, QosReliability.RELIABLE, durability, _FOREVER,
               _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)


_STREAM = _qos(QosDurability.VOLATILE, 10)
_LATCHED = _qos(QosDurability.TRANSIENT_LOCAL, 1)


class BagWriter:
    """
    A new rosbag2 directory (MCAP, zstd chunks), as a context manager.

    Raises
    ------
    BagError
        On entering, if the path exists already or cannot be made.

    """

    def __init__(self, path: Path) -> None:
        """Remember the path; nothing is made before the context is entered."""
        self.path = path
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> BagWriter:
        """Make the directory."""
        try:
            self._writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except WriterError:
            raise BagError(f'{self.path}: exists already; name a new directory') from None
        except OSError as error:
            raise BagError(f'{self.path}: cannot be made: {error.strerror}') from None
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the bag: also what an interruption left is a bag."""
        self._writer.close()

    def scan(self, scanner: Scanner, scan: Scan, log_ns: int) -> None:
        """Write a scan of one mirror turn as sensor_msgs/LaserScan on the scanner's topic."""
        steps = max(len(scan) - 1, 1)
        remission = np.empty(0) if scan.intensities is None else scan.intensities
        message = self._new(
            'sensor_msgs/msg/LaserScan',
            header=self._header(scan.stamp_ns, scanner.frame),
            angle_min=float(scan.angles[0]), angle_max=float(scan.angles[-1]),
            angle_increment=float(scan.angles[-1] - scan.angles[0]) / steps,
            time_increment=float(scan.times[-1] - scan.times[0]) / steps,
            scan_time=MIRROR_TURN, range_min=scan.range_min, range_max=scan.range_max,
            ranges=scan.ranges.astype(np.float32), intensities=remission.astype(np.float32))
        self._write('/' + scanner.topic.lstrip('/'), message, log_ns)

    def static_transforms(self, scanners: Sequence[Scanner], stamp_ns: int) -> None:
        """Write the mounts as one latched tf2_msgs/TFMessage on /tf_static."""
        transforms = []
        for scanner in scanners:
            quat = geometry.quat_from_rotation(scanner.T_base_laser[:3, :3])
            transforms.append(self._new(
                'geometry_msgs/msg/TransformStamped',
                header=self._header(stamp_ns, 'base_link'), child_frame_id=scanner.frame,
                transform=self._new(
                    'geometry_msgs/msg/Transform',
                    translation=self._vector(scanner.T_base_laser[:3, 3]),
                    rotation=self._quaternion(quat))))
        message = self._new('tf2_msgs/msg/TFMessage', transforms=transforms)
        self._write('/tf_static', message, stamp_ns, _LATCHED)

    def odometry(self, topic: str, stamp_ns: int, pose: Array, twist: Array) -> None:
        """
        Write base_link in odom as nav_msgs/Odometry, covariances zero.

        Parameters
        ----------
        topic
            With its leading slash.
        stamp_ns
            Nanoseconds; also the time it is logged at.
        pose
            (6,) x, y, z in metres, roll, pitch, yaw in radians.
        twist
            (6,) linear velocity in m/s and angular in rad/s of base_link in base_link.

        """
        at = self._new('geometry_msgs/msg/Point', x=float(pose[0]), y=float(pose[1]),
                       z=float(pose[2]))
        quat = geometry.quat_from_rpy(pose[3:])
        posed = self._new('geometry_msgs/msg/Pose', position=at,
                          orientation=self._quaternion(quat))
        moving = self._new('geometry_msgs/msg/Twist', linear=self._vector(twist[:3]),
                           angular=self._vector(twist[3:]))
        zero = np.zeros(36)
        message = self._new(
            'nav_msgs/msg/Odometry', header=self._header(stamp_ns, 'odom'),
            child_frame_id='base_link',
            pose=self._new('geometry_msgs/msg/PoseWithCovariance', pose=posed, covariance=zero),
            twist=self._new('geometry_msgs/msg/TwistWithCovariance', twist=moving,
                            covariance=zero))
        self._write(topic, message, stamp_ns)

    def _new(self, kind: str, **fields: Any) -> Any:
        return self._store.types[kind](**fields)

    def _vector(self, xyz: Array) -> Any:
        return self._new('geometry_msgs/msg/Vector3', x=float(xyz[0]), y=float(xyz[1]),
                         z=float(xyz[2]))

    def _quaternion(self, quat_xyzw: Array) -> Any:
        x, y, z, w = (float(v) for v in quat_xyzw)
        return self._new('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self._new('builtin_interfaces/msg/Time', sec=stamp_ns // 10**9,
                          nanosec=stamp_ns % 10**9)
        return self._new('std_msgs/msg/Header', stamp=stamp, frame_id=frame)

    def _write(self, topic: str, message: Any, log_ns: int, qos: Qos = _STREAM) -> None:
        """Write one message; the first on a topic opens its connection."""
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=[qos])
        data = self._store.serialize_cdr(message, kind)
        self._writer.write(self._connections[topic], log_ns, data)
