# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node: vertical scans and the final path in, facade points out."""

from __future__ import annotations

from functools import cache, partial
from itertools import chain
from pathlib import Path as FilePath
import sys
from typing import Any

from nav_msgs.msg import Path
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import LaserScan, PointCloud2

from stri_mapping.facade.cloud_files import PLY_NAME
from stri_mapping.facade.journal import Journal
from stri_mapping.facade.overview import Overview
from stri_mapping.facade.points import FacadePoints
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.facade.takeover import Takeover
from stri_mapping.facade.writer import facade_facts, FacadeWriter
from stri_mapping.nodes import conversions
from stri_mapping.nodes.diagnostics import Diagnostics, OK, Report, WARN
from stri_mapping.nodes.parameters import declare, NodeSettings
from stri_mapping.nodes.polling import take_all
from stri_mapping.nodes.process import run_node
from stri_mapping.nodes.qos import advertise, subscribe
from stri_mapping.nodes.results_output import ResultsOutput
from stri_mapping.nodes.scan_input import JUMP_NS, ScanInput
from stri_mapping.nodes.transforms import mounts_from_tf
from stri_mapping.scan import Scan, scan_from_message
from stri_mapping.summary import scanner_facts

# All poses there are, those from before this node connected included.
TRAJECTORY_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL,
                            durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MAP_PERIOD = 2.0


class FacadeAlignerNode:
    """Feeds the aligner with the vertical scanners' topics and the path; publishes its points."""

    upstream = ('trajectory',)
    prompt = None                               # poses come seconds after the scans

    def __init__(self) -> None:
        """Declare, then connect."""
        self.node = Node('facade_aligner')
        self.settings = declare(self.node, NodeSettings)
        self._folder = self.settings.results_folder()
        self._vehicle, _ = mounts_from_tf(self.node, self.settings)
        scanners = self._vehicle.verticals
        prepare()
        self._aligner = self._new_aligner()
        self._overview = Overview()
        self._writer = (FacadeWriter(self._folder, [s.name for s in scanners],
                                     append=self.settings.resume) if self._folder else None)
        self._results = ResultsOutput(self.node, self._folder, self._writer)
        self._journal = Journal(self._folder, self.settings.resume)
        self._takeover: Takeover | None = None
        self._yaw = 0.0                          # of the newest pose
        self._newest = 0                         # its stamp, ns
        self._heard = 0                          # stamp of the last pose that came, ns
        self._kept = 0                           # of the newest one from before a crash, ns
        self._mapped = 0                         # points in the map as last published
        # by scanner: scans of a time that was set back, which the path has yet to follow
        self._ahead: dict[int, list[Scan]] = {}
        self._points = advertise(self.node, PointCloud2, 'facade/points', 100)
        self._map = advertise(self.node, PointCloud2, 'facade/map', LATCHED)
        self.node.create_timer(MAP_PERIOD, self._catch_up,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = Diagnostics(self.node, {'facades': self._report})
        self._path = subscribe(self.node, Path, 'trajectory', self._take_path, TRAJECTORY_QOS,
                               raw=True)
        self.inputs = [ScanInput(self.node, scanner, partial(self._add_scan, ring),
                                 partial(self._hold, ring),
                                 self.settings.scan_log(scanner))
                       for ring, scanner in enumerate(scanners)]
        if self._folder is not None and self.settings.resume:
            self._take_over(self._folder / PLY_NAME)        # scans gather in the readers meanwhile

    def _new_aligner(self) -> FacadeAligner:
        return FacadeAligner(self._vehicle.verticals,
                             self._vehicle.horizontal.T_base_laser[:3, 3])

    def _take_over(self, cloud: FilePath) -> None:
        """Take what the node that was killed had taken; what waited there waits here."""
        self._takeover = Takeover(self._aligner, self._journal.read_back(), cloud, _scan)
        self._newest, self._yaw = self._takeover.newest
        self._kept = self._newest
        self.node.get_logger().info(
            f'{self._takeover.scans} scans from before the crash are at hand')

    def _add_scan(self, ring: int, scan: Scan, message: bytes) -> None:
        """Take a scan; those of a time that the path has not come back to have to wait."""
        if ring in self._ahead:
            self._ahead[ring].append(scan)
            return
        self._journal.add_scan(ring, scan.stamp_ns, message)
        self._aligner.add_scan(ring, scan)

    def _hold(self, ring: int) -> None:
        """Let a scanner's scans wait from now on: time was set back, the path has yet to be."""
        self._ahead.setdefault(ring, [])

    def _take_path(self, message: bytes) -> None:
        """Take a message of the path; those from before a crash, which come again, in one go."""
        behind = (data for data, _ in take_all(self._path))
        for data in chain([message], behind):
            stamp = conversions.header_stamp(data)
            if not max(self._heard - JUMP_NS, 1) <= stamp <= self._kept:
                # one at a time: scans are taken in between, or they would pass for missing
                self._add_path(deserialize_message(data, Path))
                break
            self._heard = stamp
        self._publish(self._take())

    def _add_path(self, message: Path) -> None:
        stamps, poses = conversions.poses_from_path(message, self._yaw)
        if not len(stamps):
            return
        if stamps[0] < self._heard - JUMP_NS:
            self._begin_anew()
        self._heard = int(stamps[-1])
        if self._heard <= self._newest:
            return
        self._yaw, self._newest = float(poses[-1, 2]), self._heard
        self._journal.add_poses(stamps, poses)
        self._aligner.add_poses(stamps, poses)

    def _begin_anew(self) -> None:
        """Begin another drive: time was set back.  The results stay those of the first."""
        self.node.get_logger().warning(
            'time was set back by more than a second: the facades begin anew'
            + ('; the results folder keeps those before' if self._results.wanted else ''))
        self._complete()
        # the new tables take the room of the old ones: beside them they would grow the heap
        del self._aligner, self._overview
        self._aligner, self._overview = self._new_aligner(), Overview()
        self._takeover = None
        self._yaw, self._newest, self._kept, self._mapped = 0.0, 0, 0, 0
        for ring, each in enumerate(self.inputs):
            if ring not in self._ahead:
                each.forget()
            for scan in self._ahead.pop(ring, []):
                self._aligner.add_scan(ring, scan)

    def _take(self) -> FacadePoints:
        """Return what became final, and write it where results are wanted."""
        points, poses = self._aligner.take_points(), self._aligner.take_poses()
        if self._takeover is not None:
            points = self._takeover.new(points)
        if self._writer is not None:
            self._results.write(partial(self._writer.write, points, *poses))
        if self._results.fault is not None:      # no cloud that another could go on with
            self._journal.close()
        self._journal.add_counts(self._aligner.counts)
        if len(poses[0]):
            self._journal.forget(int(poses[0][-1]))
        return points

    def _publish(self, points: FacadePoints) -> None:
        for message in conversions.cloud_messages(points, self.settings.odom_frame):
            self._points.publish(message)
        self._overview.add(points.xyz)

    def _catch_up(self) -> None:
        """Publish what scans that came after their path made final, and the map."""
        self._publish(self._take())
        self._publish_map()

    def _publish_map(self) -> None:
        if len(self._overview) == self._mapped:
            return
        self._mapped = len(self._overview)
        self._map.publish(conversions.map_message(
            self._overview.points(), self._newest, self.settings.odom_frame))

    def _report(self) -> Report:
        return self._results.report(self._state())

    def _state(self) -> Report:
        counts = self._aligner.counts
        values = {'Scans': counts.scans, 'Points': counts.points,
                  'Rays without a pose': counts.outside,
                  'Roll stabilised (%)': round(100.0 * counts.roll_told / max(counts.points, 1)),
                  'Pitch stabilised (%)': round(100.0 * counts.pitch_told / max(counts.points, 1)),
                  'Yaw corrected (%)': round(100.0 * counts.yaw_told / max(counts.points, 1)),
                  'Malformed scans': sum(i.counts.malformed for i in self.inputs),
                  'Scans out of order': sum(i.counts.backwards for i in self.inputs)}
        if counts.scans == 0:
            return Report(WARN, 'no scans yet', values)
        if self._newest == 0:
            return Report(WARN, 'no path yet', values)
        return Report(OK, 'mapping', values)

    def finish(self) -> None:
        """Place what can be placed; publish and write it; raises ResultsError if it cannot."""
        self._complete()
        self._results.check()

    def _complete(self) -> None:
        self._aligner.finish()
        self._publish(self._take())
        self._publish_map()
        self._results.close(self._facts)
        self._journal.close()
        for each in self.inputs:
            each.close()

    def _facts(self) -> dict[str, Any]:
        return {**facade_facts(self._aligner),
                'scanners': [scanner_facts(self._vehicle, scanner, each.stamps, each.counts)
                             for scanner, each in zip(self._vehicle.verticals, self.inputs)]}


def _scan(message: bytes) -> Scan:
    """Return the scan of a serialised message that was good when it came."""
    return scan_from_message(deserialize_message(message, LaserScan))


@cache
def prepare() -> None:
    """Load or compile what the aligner needs, so that a start is quick."""
    FacadeAligner(NodeSettings().vehicle().verticals).warm_up()


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(FacadeAlignerNode, args)


if __name__ == '__main__':
    sys.exit(main())
