# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node: vertical scans and the final path in, facade points out."""

from __future__ import annotations

from functools import partial
import sys
from typing import Any

from nav_msgs.msg import Path
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2

from stri_mapping.facade.cloud_files import CloudWriter
from stri_mapping.facade.overview import Overview
from stri_mapping.facade.push_broom import FacadeAligner, FacadePoints
from stri_mapping.nodes import conversions
from stri_mapping.nodes.diagnostics import Diagnostics, OK, Report, WARN
from stri_mapping.nodes.parameters import declare, NodeSettings
from stri_mapping.nodes.process import run_node
from stri_mapping.nodes.scan_input import ScanInput
from stri_mapping.nodes.transforms import mounts_from_tf
from stri_mapping.results import scanner_facts, write_summary

# All poses there are, those from before this node connected included.
TRAJECTORY_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL,
                            durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MAP_PERIOD = 2.0


class FacadeAlignerNode:
    """Feeds the aligner with the vertical scanners' topics and the path; publishes its points."""

    def __init__(self) -> None:
        """Declare, then connect."""
        self.node = Node('facade_aligner')
        self.settings = declare(self.node, NodeSettings)
        self._folder = self.settings.results_folder()
        self._vehicle = mounts_from_tf(self.node, self.settings)
        scanners = self._vehicle.verticals
        self._aligner = FacadeAligner(scanners)
        self._overview = Overview()
        self._writer = (CloudWriter(self._folder, [s.name for s in scanners])
                        if self._folder else None)
        self._yaw = 0.0                          # of the newest pose
        self._newest = 0                         # its stamp, ns
        self._mapped = 0                         # points in the map as last published
        self._points = self.node.create_publisher(PointCloud2, 'facade/points', 100)
        self._map = self.node.create_publisher(PointCloud2, 'facade/map', LATCHED)
        self.node.create_timer(MAP_PERIOD, self._publish_map,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = Diagnostics(self.node, {'facades': self._report})
        self.node.create_subscription(Path, 'trajectory', self._take_path, TRAJECTORY_QOS)
        self._inputs = [ScanInput(self.node, scanner, partial(self._aligner.add_scan, ring))
                        for ring, scanner in enumerate(scanners)]

    def _take_path(self, message: Path) -> None:
        stamps, poses = conversions.poses_from_path(message, self._yaw)
        if not len(stamps):
            return
        self._yaw, self._newest = float(poses[-1, 2]), int(stamps[-1])
        self._aligner.add_poses(stamps, poses)
        self._publish(self._aligner.take_points())

    def _publish(self, points: FacadePoints) -> None:
        for message in conversions.cloud_messages(points, self.settings.odom_frame):
            self._points.publish(message)
        self._overview.add(points.xyz)
        if self._writer is not None:
            self._writer.write(points)

    def _publish_map(self) -> None:
        if len(self._overview) == self._mapped:
            return
        self._mapped = len(self._overview)
        self._map.publish(conversions.map_message(
            self._overview.points(), self._newest, self.settings.odom_frame))

    def _report(self) -> Report:
        counts = self._aligner.counts
        values = {'Scans': counts.scans, 'Points': counts.points,
                  'Rays without a pose': counts.outside,
                  'Malformed scans': sum(i.counts.malformed for i in self._inputs),
                  'Scans out of order': sum(i.counts.backwards for i in self._inputs)}
        if counts.scans == 0:
            return Report(WARN, 'no scans yet', values)
        if self._newest == 0:
            return Report(WARN, 'no path yet', values)
        return Report(OK, 'mapping', values)

    def finish(self) -> None:
        """Place what can be placed; publish and write it."""
        self._aligner.finish()
        self._publish(self._aligner.take_points())
        self._publish_map()
        if self._writer is not None and self._folder is not None:
            self._writer.close()
            write_summary(self._folder, self._facts())

    def _facts(self) -> dict[str, Any]:
        rays = self._aligner.counts
        return {'rays_without_return': rays.no_return, 'rays_without_pose': rays.outside,
                'scanners': [scanner_facts(self._vehicle, scanner, each.stamps, each.counts)
                             for scanner, each in zip(self._vehicle.verticals, self._inputs)]}


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(FacadeAlignerNode, args)


if __name__ == '__main__':
    sys.exit(main())
