# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Three topics heard by Cyclone DDS, with types of its own: not one line of ROS in it."""

# no annotations from the future: Cyclone DDS reads its types from the annotations

from dataclasses import dataclass
from types import TracebackType

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

# Where the others are: this machine alone, on the ports that participants 0 to 40 have.
LOOPBACK = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"
  multicast="false"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex>
  <MaxAutoParticipantIndex>40</MaxAutoParticipantIndex>
  <Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""


@dataclass
class Time(IdlStruct, typename='builtin_interfaces::msg::dds_::Time_'):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename='std_msgs::msg::dds_::Header_'):
    stamp: Time
    frame_id: str


@dataclass
class LaserScan(IdlStruct, typename='sensor_msgs::msg::dds_::LaserScan_'):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@dataclass
class Vector3(IdlStruct, typename='geometry_msgs::msg::dds_::Vector3_'):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename='geometry_msgs::msg::dds_::Quaternion_'):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename='geometry_msgs::msg::dds_::Pose_'):
    position: Vector3
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename='geometry_msgs::msg::dds_::PoseWithCovariance_'):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename='geometry_msgs::msg::dds_::Twist_'):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename='geometry_msgs::msg::dds_::TwistWithCovariance_'):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename='nav_msgs::msg::dds_::Odometry_'):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class PointField(IdlStruct, typename='sensor_msgs::msg::dds_::PointField_'):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
class PointCloud2(IdlStruct, typename='sensor_msgs::msg::dds_::PointCloud2_'):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


class Listener:
    """Hears everything on three topics; a context manager."""

    def __init__(self, domain: int) -> None:
        self._domain = Domain(domain, LOOPBACK)
        self._participant = DomainParticipant(domain)
        qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepAll)
        self.scans: list[LaserScan] = []
        self.odometry: list[Odometry] = []
        self.clouds: list[PointCloud2] = []
        self._readers = {
            name: (DataReader(
                self._participant, Topic(self._participant, f'rt/{name}', kind), qos), into)
            for name, kind, into in (('horizontal/scan', LaserScan, self.scans),
                                     ('odom', Odometry, self.odometry),
                                     ('facade/points', PointCloud2, self.clouds))}

    def __enter__(self) -> 'Listener':
        return self

    def __exit__(
        self,
        kind: 'type[BaseException] | None',
        error: 'BaseException | None',
        trace: 'TracebackType | None',
    ) -> None:
        self._readers.clear()

    def matched(self, name: str) -> bool:
        """Return whether somebody publishes what is listened to."""
        return bool(self._readers[name][0].get_matched_publications())

    def take(self) -> None:
        """Take what has come."""
        for reader, into in self._readers.values():
            into += [sample for sample in reader.take(N=1000) if not hasattr(sample, 'sample_info')
                     or sample.sample_info.valid_data]
