# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Messages from estimates, points and pictures, and poses from messages; message classes only."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping, Sequence
import math
import struct
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Pose,
    PoseStamped,
    TransformStamped,
    Twist,
    TwistWithCovarianceStamped,
)
from nav_msgs.msg import Odometry, Path
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image, LaserScan, PointCloud2, PointField

from stri_mapping import geometry
from stri_mapping.scan import stamp_ns

if TYPE_CHECKING:               # each node needs but some of them, and a restart is to be quick
    from stri_mapping.facade.points import FacadePoints
    from stri_mapping.lms.stamps import TimedScan
    from stri_mapping.stri.estimate import Estimate
    from stri_mapping.vehicle import Vehicle

Array = NDArray[np.float64]

# Variance of what a planar estimate does not tell (height, roll, pitch): large but finite.
UNOBSERVED = 1e6
NOT_PLANAR = np.diag([0.0, 0.0, UNOBSERVED, UNOBSERVED, UNOBSERVED, 0.0]).ravel()
PLANAR = np.add.outer([0, 6, 30], [0, 1, 5]).ravel()
# One facade point in 24 bytes: `time` counts in seconds from the header's stamp.
NAMES = ('x', 'y', 'z', 'intensity', 'time', 'ring')
POINT = np.dtype({'names': NAMES, 'formats': [*5 * ['<f4'], '<u2'], 'itemsize': 24})
POINT_FIELDS = [
    PointField(name=name, offset=4 * index, count=1,
               datatype=PointField.UINT16 if name == 'ring' else PointField.FLOAT32)
    for index, name in enumerate(NAMES)]
# Metres: nothing nearer to a line scanner's window than this was measured.
RANGE_MIN = 0.01
# Larger messages get lost or stall the link, with other makes of DDS above all; 120 kB.
POINTS_PER_MESSAGE = 5_000


def time_message(stamp: int) -> Time:
    """Return integer nanoseconds as a message."""
    return Time(sec=stamp // 10**9, nanosec=stamp % 10**9)


def scan_message(timed: TimedScan, frame: str, intensities: bool = True) -> LaserScan:
    """Return a scan, with or without its intensities, if it has any."""
    scan, step = timed.scan, math.radians(timed.scan.step)
    first = math.radians(scan.first - 90.0)
    message = LaserScan(
        angle_min=first, angle_max=first + (len(scan.ranges) - 1) * step, angle_increment=step,
        time_increment=timed.time_increment, scan_time=timed.scan_time,
        range_min=RANGE_MIN, range_max=scan.range_max, ranges=_floats(scan.ranges))
    if intensities and scan.intensities is not None:
        message.intensities = _floats(scan.intensities)
    message.header.frame_id = frame
    message.header.stamp = time_message(timed.stamp_ns)
    return message


def covariance_6x6(planar: Array) -> Array:
    """Return the row-major (36,) covariance of (x, y, z, rotX, rotY, rotZ) of a planar one."""
    full = NOT_PLANAR.copy()
    full[PLANAR] = (0.5 * (planar + planar.T)).ravel()      # it comes symmetric to rounding
    return full


def odometry_message(estimate: Estimate, odom_frame: str, base_frame: str) -> Odometry:
    """Return pose (in odom) and twist (in the base frame) with their covariances."""
    message = Odometry(child_frame_id=base_frame)
    message.header.frame_id = odom_frame
    message.header.stamp = time_message(estimate.stamp_ns)
    _set_pose(message.pose.pose, estimate.pose)
    message.pose.covariance = covariance_6x6(estimate.pose_covariance)
    _set_twist(message.twist.twist, estimate.twist)
    message.twist.covariance = covariance_6x6(estimate.twist_covariance)
    return message


def truth_messages(stamps: Sequence[int], poses: Array, twists: Array) -> Iterator[Odometry]:
    """Return true poses (n, 6) as x, y, z, roll, pitch, yaw with their velocities (n, 6)."""
    quats = geometry.quat_from_rpy(poses[:, 3:]).tolist()
    for stamp, pose, quat, twist in zip(stamps, poses.tolist(), quats, twists.tolist()):
        message = Odometry(child_frame_id='base_link')
        message.header.frame_id = 'odom'
        message.header.stamp = time_message(stamp)
        at, turned = message.pose.pose.position, message.pose.pose.orientation
        at.x, at.y, at.z = pose[:3]
        turned.x, turned.y, turned.z, turned.w = quat
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        linear.x, linear.y, linear.z = twist[:3]
        angular.x, angular.y, angular.z = twist[3:]
        yield message


def velocity_message(estimate: Estimate, base_frame: str) -> TwistWithCovarianceStamped:
    """Return the twist of the base frame in itself, with its covariance."""
    message = TwistWithCovarianceStamped()
    message.header.frame_id = base_frame
    message.header.stamp = time_message(estimate.stamp_ns)
    _set_twist(message.twist.twist, estimate.twist)
    message.twist.covariance = covariance_6x6(estimate.twist_covariance)
    return message


def transform_message(estimate: Estimate, odom_frame: str, base_frame: str) -> TransformStamped:
    """Return the transform odom -> base_link."""
    message = TransformStamped(child_frame_id=base_frame)
    message.header.frame_id = odom_frame
    message.header.stamp = time_message(estimate.stamp_ns)
    x, y, yaw = estimate.pose.tolist()
    message.transform.translation.x, message.transform.translation.y = x, y
    _, _, message.transform.rotation.z, message.transform.rotation.w = geometry.quat_from_yaw(yaw)
    return message


def mount_messages(vehicle: Vehicle, base_frame: str) -> list[TransformStamped]:
    """Return the transforms from the base frame to the scanners'; they hold at any time."""
    found = []
    for scanner in vehicle.scanners:
        message = TransformStamped(child_frame_id=scanner.frame)
        message.header.frame_id = base_frame
        to, turn = message.transform.translation, message.transform.rotation
        to.x, to.y, to.z = (float(v) for v in scanner.T_base_laser[:3, 3])
        quat = geometry.quat_from_rotation(scanner.T_base_laser[:3, :3])
        turn.x, turn.y, turn.z, turn.w = (float(v) for v in quat)
        found.append(message)
    return found


def path_message(estimates: Sequence[Estimate], odom_frame: str) -> Path:
    """Return the poses of some estimates; the header carries the last one's stamp."""
    message = Path()
    message.header.frame_id = odom_frame
    for estimate in estimates:
        pose = PoseStamped()
        pose.header.frame_id = odom_frame
        pose.header.stamp = time_message(estimate.stamp_ns)
        _set_pose(pose.pose, estimate.pose)
        message.poses.append(pose)
        message.header.stamp = pose.header.stamp
    return message


def header_stamp(data: bytes) -> int:
    """Return the stamp in nanoseconds of a serialised message that begins with a header."""
    seconds, nanoseconds = struct.unpack_from('<iI' if data[1] & 1 else '>iI', data, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


def poses_from_path(message: Path, yaw: float = 0.0) -> tuple[NDArray[np.int64], Array]:
    """
    Return the stamps (n,) in ns and the planar poses (n, 3) of a path.

    Parameters
    ----------
    message
        The path.
    yaw
        Heading of the pose before it: quaternions know headings to full turns only, and the
        returned ones continue from this one.

    """
    stamps = np.array([stamp_ns(p.header.stamp) for p in message.poses], dtype=np.int64)
    positions = [(p.pose.position.x, p.pose.position.y) for p in message.poses]
    quats = [(q.x, q.y, q.z, q.w) for q in (p.pose.orientation for p in message.poses)]
    yaws = geometry.yaw_from_quat(np.reshape(quats, (-1, 4)))
    continued = np.unwrap(np.concatenate([[yaw], yaws]))[1:]
    return stamps, np.column_stack([np.reshape(positions, (-1, 2)), continued])


def cloud_messages(points: FacadePoints, odom_frame: str) -> Iterator[PointCloud2]:
    """Return facade points as messages of 120 kB at most; each stamp is its first point's time."""
    for start in range(0, len(points.stamps_ns), POINTS_PER_MESSAGE):
        piece = slice(start, start + POINTS_PER_MESSAGE)
        stamps = points.stamps_ns[piece]
        first = int(stamps.min())
        records = np.zeros(len(stamps), dtype=POINT)
        records['x'], records['y'], records['z'] = points.xyz[piece].T
        records['intensity'] = points.intensity[piece]
        records['time'] = (stamps - first) * 1e-9
        records['ring'] = points.ring[piece]
        yield cloud_message(records, POINT_FIELDS, first, odom_frame)


def map_message(xyz: Array, stamp: int, odom_frame: str) -> PointCloud2:
    """Return points (n, 3) alone, for viewers."""
    records = xyz.astype('<f4').view([('x', '<f4'), ('y', '<f4'), ('z', '<f4')]).ravel()
    return cloud_message(records, POINT_FIELDS[:3], stamp, odom_frame)


def cloud_message(
    records: NDArray[np.void], point_fields: Sequence[PointField], stamp: int, frame: str,
) -> PointCloud2:
    """Return an unordered cloud of structured records."""
    message = PointCloud2(
        height=1, width=len(records), fields=list(point_fields), is_bigendian=False,
        point_step=records.itemsize, row_step=records.nbytes, data=_bytes(records),
        is_dense=bool(np.all(np.isfinite(records['x']))))
    message.header.frame_id = frame
    message.header.stamp = time_message(stamp)
    return message


def image_message(picture: NDArray[np.uint8], stamp: int, frame: str) -> Image:
    """Return a grey (rows, columns) or RGB (rows, columns, 3) picture."""
    height, width, *colours = picture.shape
    message = Image(height=height, width=width, step=picture.nbytes // max(height, 1),
                    encoding='rgb8' if colours else 'mono8', data=_bytes(picture))
    message.header.frame_id = frame
    message.header.stamp = time_message(stamp)
    return message


def status_message(
    name: str, level: bytes, text: str, values: Mapping[str, object], hardware: str = '',
) -> DiagnosticStatus:
    """Return one diagnostic status; values become strings."""
    return DiagnosticStatus(
        name=name, level=level, message=text, hardware_id=hardware,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])


def _bytes(values: NDArray[np.generic]) -> array[int]:
    """Return the bytes as the one type that the message classes take without looping."""
    data = array('B')
    data.frombytes(np.ascontiguousarray(values).tobytes())
    return data


def _floats(values: Array) -> array[float]:
    """Return the values as the one type that the message classes take without looping."""
    data = array('f')
    data.frombytes(values.astype(np.float32).tobytes())
    return data


def _set_pose(message: Pose, pose: Array) -> None:
    x, y, yaw = pose.tolist()
    message.position.x, message.position.y = x, y
    _, _, message.orientation.z, message.orientation.w = geometry.quat_from_yaw(yaw)


def _set_twist(message: Twist, twist: Array) -> None:
    message.linear.x, message.linear.y, message.angular.z = twist.tolist()
