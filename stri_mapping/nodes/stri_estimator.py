# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node: horizontal scans in, odometry, velocity and the final path out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from functools import cache, partial
import sys
from time import perf_counter
from typing import Any

from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image

from stri_mapping.disk import keeping
from stri_mapping.motion_file import MotionWriter
from stri_mapping.nodes import conversions
from stri_mapping.nodes.diagnostics import Diagnostics, OK, Report, WARN
from stri_mapping.nodes.parameters import declare, NodeSettings
from stri_mapping.nodes.process import run_node
from stri_mapping.nodes.qos import advertise
from stri_mapping.nodes.results_output import ResultsOutput
from stri_mapping.nodes.scan_input import ScanInput
from stri_mapping.nodes.transforms import mounts_from_tf, TransformOutput
from stri_mapping.results import RANGE_IMAGE_NAME
from stri_mapping.resume import interruption, placed
from stri_mapping.scan import Scan
from stri_mapping.stri.config import EstimatorConfig
from stri_mapping.stri.estimate import Estimate
from stri_mapping.stri.estimator import StriEstimator
from stri_mapping.summary import scanner_facts

# Latched and deep: an aligner that starts or connects late still gets every pose.
TRAJECTORY_QOS = QoSProfile(depth=5000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# Seconds of final poses gathered into one message: ten messages a second, not 75.
PATH_SPAN_NS = 100_000_000
PICTURE_PERIOD = 0.5
# Scans over which the latency is told, and milliseconds beyond which it is none.
LATENCIES, REAL_TIME = 375, 10_000.0
Array = NDArray[np.float64]


@dataclass(frozen=True)
class EstimatorSettings(NodeSettings):
    """
    What the estimator's node can be told beside what every processing node can.

    Attributes
    ----------
    publish_tf
        Whether to publish the transform from odom to base_link; false where another node does.
    publish_static_tf
        Whether to publish those mounts of the vehicle file that nobody else has on /tf_static.
    estimator
        Settings of the estimator.

    """

    publish_tf: bool = True
    publish_static_tf: bool = True
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)


class StriEstimatorNode:
    """Feeds the estimator with the horizontal scanner's topic and publishes what it says."""

    upstream = ()

    def __init__(self) -> None:
        """Declare, warm up, then connect: a matched subscription means readiness."""
        self.node = Node('stri_estimator')
        self.settings = declare(self.node, EstimatorSettings)
        self._folder = self.settings.results_folder()
        self._tf = TransformOutput(self.node)
        self._vehicle, heard = mounts_from_tf(self.node, self.settings)
        if self.settings.publish_static_tf:
            self._tf.publish_static([
                mount for mount in conversions.mount_messages(
                    self._vehicle, self.settings.base_frame) if mount.child_frame_id not in heard])
        self.node.get_logger().info('preparing; the first time, this compiles for a while')
        prepare()
        self._estimator = self._new_estimator()
        self._before = (interruption(self._folder)
                        if self._folder and self.settings.resume else None)
        self._writer = (MotionWriter(self._folder, append=self._before is not None)
                        if self._folder else None)
        self._results = ResultsOutput(self.node, self._folder, self._writer)
        self._T_odom_start: Array | None = None  # where a path that was interrupted goes on
        self._final: list[Estimate] = []         # final, not yet published
        self._newest: Estimate | None = None
        self._distance, self._seconds_busy = 0.0, 0.0
        self._latencies: deque[float] = deque(maxlen=LATENCIES)
        self._advertise()
        self.prompt = ScanInput(self.node, self._vehicle.horizontal, self._take, self._begin_anew,
                                self.settings.scan_log(self._vehicle.horizontal))
        self.inputs = (self.prompt,)
        self._resumed_at = len(self.prompt.stamps)      # scans that came before a crash

    def _new_estimator(self) -> StriEstimator:
        scanner = self._vehicle.horizontal
        return StriEstimator(scanner.T_base_laser,
                             self.settings.estimator.knowing(scanner.footprint_pull))

    def _advertise(self) -> None:
        self._odometry = advertise(self.node, Odometry, 'odom', 100)
        self._velocity = advertise(self.node, TwistWithCovarianceStamped, 'velocity', 100)
        self._path = advertise(self.node, Path, 'trajectory', TRAJECTORY_QOS)
        self._image = advertise(self.node, Image, 'stri/image', 2)
        self._segments = advertise(self.node, Image, 'stri/segments', 2)
        self.node.create_timer(PICTURE_PERIOD, self._publish_pictures,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = Diagnostics(self.node, {'motion': self._report})

    def _take(self, scan: Scan, _: bytes) -> None:
        start = perf_counter()
        estimate = self._estimator.add(scan)
        self._seconds_busy += perf_counter() - start
        if estimate is not None:
            self._publish(self._placed(estimate))
            self._note_latency(scan)
        self._final += map(self._placed, self._estimator.take_refined())
        if self._final and self._final[-1].stamp_ns - self._final[0].stamp_ns >= PATH_SPAN_NS:
            self._publish_final()

    def _placed(self, estimate: Estimate) -> Estimate:
        """Return an estimate in odom, also where its path is the second part of a drive."""
        if self._before is None:
            return estimate
        if self._T_odom_start is None:
            self._T_odom_start = self._before.pose_at(self.prompt.stamps[self._resumed_at])
        return placed(estimate, self._T_odom_start)

    def _note_latency(self, scan: Scan) -> None:
        last_ray_ns = scan.stamp_ns + 1e9 * float(scan.times.max(initial=0.0))
        self._latencies.append(1e-6 * (self.node.get_clock().now().nanoseconds - last_ray_ns))

    def _publish(self, estimate: Estimate) -> None:
        odom, base = self.settings.odom_frame, self.settings.base_frame
        if self._newest is not None:
            self._distance += float(np.hypot(*(estimate.pose - self._newest.pose)[:2]))
        self._newest = estimate
        self._odometry.publish(conversions.odometry_message(estimate, odom, base))
        self._velocity.publish(conversions.velocity_message(estimate, base))
        if self.settings.publish_tf:
            self._tf.publish(conversions.transform_message(estimate, odom, base))

    def _publish_final(self) -> None:
        final, self._final = self._final, []
        if not final:
            return
        self._path.publish(conversions.path_message(final, self.settings.odom_frame))
        if self._writer is not None:
            self._results.write(partial(self._writer.write, final))

    def _begin_anew(self) -> None:
        """Begin another drive: time was set back.  The results stay those of the first."""
        self.node.get_logger().warning(
            'time was set back by more than a second: a new path begins'
            + ('; the results folder keeps the one before' if self._results.wanted else ''))
        self._complete()
        self._estimator = self._new_estimator()
        self._before = self._newest = self._T_odom_start = None
        self._distance = 0.0
        self._latencies.clear()

    def _publish_pictures(self) -> None:
        image = self._estimator.range_image
        if len(image) == 0 or self._newest is None:
            return
        for publisher, picture in ((self._image, image.picture),
                                   (self._segments, image.segment_picture)):
            if publisher.get_subscription_count():
                publisher.publish(conversions.image_message(
                    picture(), self._newest.stamp_ns, self._vehicle.horizontal.frame))

    def _report(self) -> Report:
        return self._results.report(self._state())

    def _state(self) -> Report:
        counts, newest = self.prompt.counts, self._newest
        values = {'Scans': counts.read, 'Malformed scans': counts.malformed,
                  'Scans out of order': counts.backwards,
                  'Milliseconds per scan': f'{1e3 * self._seconds_busy / max(counts.read, 1):.2f}'}
        if counts.read == 0:
            return Report(WARN, 'no scans yet', values)
        if newest is None:
            return Report(OK, 'starting up', values)
        values |= {'Speed': f'{newest.twist[0]:.2f} m/s', 'Quality': f'{newest.quality:.2f}',
                   'Distance': f'{self._distance:.1f} m',
                   'Footprint pull': f'{1e5 * self._estimator.footprint_pull:.1f}e-5 1/m'}
        latency = float(np.percentile(self._latencies, 95)) if self._latencies else np.inf
        if abs(latency) < REAL_TIME:        # else the scans are not of now
            values['Latency'] = f'{latency:.1f} ms'
        if newest.degenerate:
            return Report(WARN, 'too little structure to see the motion: coasting', values)
        return Report(OK, 'tracking', values)

    def finish(self) -> None:
        """Make the last poses final; publish and write them; raises ResultsError if it cannot."""
        self._complete()
        self._results.check()

    def _complete(self) -> None:
        self._estimator.finish()
        self._final += map(self._placed, self._estimator.take_refined())
        self._publish_final()
        self._results.write(self._save_image)
        self._results.close(self._facts)
        self.prompt.close()

    def _save_image(self) -> None:
        assert self._folder is not None
        with keeping(self._folder):
            self._estimator.range_image_log.save(self._folder / RANGE_IMAGE_NAME)

    def _facts(self) -> dict[str, Any]:
        assert self._writer is not None
        scans = self.prompt.stamps
        return {'scans': len(scans), **self._writer.facts(),
                'ms_per_scan': round(1e3 * self._seconds_busy / max(len(scans), 1), 3),
                'footprint_pull': self._estimator.footprint_pull,
                'scanners': [scanner_facts(self._vehicle, self._vehicle.horizontal, scans,
                                           self.prompt.counts)]}


@cache
def prepare() -> None:
    """Load or compile what the estimator needs, so that a start is quick."""
    StriEstimator(np.eye(4)).warm_up()


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(StriEstimatorNode, args)


if __name__ == '__main__':
    sys.exit(main())
