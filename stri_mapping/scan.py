# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""One scan of a line scanner: ranges, angles and a time for every ray."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import logging
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stri_mapping.errors import ScanError

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)

# Time of one mirror turn of every SICK LMS 2xx (technical description: 75.08 Hz).
MIRROR_TURN = 0.01332
# Ray counts of merged interlaced scans of an LMS 2xx by their step in degrees: every model but
# the S14 fires at whole degrees in a turn and shifts the raster for the next turn.
INTERLACED = {0.5: (361, 201), 0.25: (401,)}


@dataclass(frozen=True, eq=False)
class Scan:
    """
    One scan as measured, in the scanner's own frame (x along 0 rad, y along pi/2 rad).

    Attributes
    ----------
    stamp_ns
        Time of the first ray, integer nanoseconds.
    ranges
        (n,) metres.  By REP-117 +inf is no return, -inf too close, NaN a meaningless reading.
    angles
        (n,) radians, counter-clockwise about z.
    times
        (n,) seconds of each ray since `stamp_ns`.
    intensities
        (n,) in the device's units, or None where the device gives none.
    range_min, range_max
        Metres; finite ranges outside are discarded measurements, kept as they are.

    Raises
    ------
    ScanError
        If the arrays differ in length.

    """

    stamp_ns: int
    ranges: Array
    angles: Array
    times: Array
    intensities: Array | None = None
    range_min: float = 0.0
    range_max: float = np.inf

    def __post_init__(self) -> None:
        """Check that every ray has a range, an angle and a time."""
        lengths = {name: len(getattr(self, name)) for name in ('ranges', 'angles', 'times')}
        if self.intensities is not None:
            lengths['intensities'] = len(self.intensities)
        if len(set(lengths.values())) > 1:
            raise ScanError(f'scan at {self.stamp_ns} ns: fields differ in length: {lengths}')

    def __len__(self) -> int:
        """Return the number of rays."""
        return len(self.ranges)

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Mask (n,) of the rays that measured something (REP-117); a length of 0 is nothing."""
        return ((self.range_min <= self.ranges) & (self.ranges <= self.range_max)
                & (self.ranges > 0.0) & np.isfinite(self.ranges))

    @property
    def end_ns(self) -> int:
        """Time of the last ray in nanoseconds; `stamp_ns` for a scan without rays."""
        # argmax takes half the time of max
        last = self.times[self.times.argmax()] if len(self) else 0.0
        return self.stamp_ns + round(1e9 * float(last))

    @cached_property
    def points(self) -> Array:
        """Points (n, 2) in the scanner frame in metres; rays that are not valid give NaN."""
        r = np.where(self.valid, self.ranges, np.nan)
        return np.stack([r * np.cos(self.angles), r * np.sin(self.angles)], axis=-1)


def ray_times(count: int, angle_increment: float, time_increment: float) -> tuple[Array, int]:
    """
    Return the time of every ray of a scan, and in how many mirror turns it was taken.

    A scan with a time increment is taken at its word.  One without, whose beam pattern is that
    of a merged interlaced scan of an LMS 2xx (180 or 100 degrees at 1/2, 100 at 1/4), was taken
    in several turns of the mirror: rays at x.00, then x.50, or x.00, .25, .50, .75, and the ray
    at bearing a of turn q comes at ``turn * (q + a / 2 pi)`` (LMS 2xx telegram listing, 10.10).
    Anything else gets one time for the whole scan: nothing better is known of it.

    Parameters
    ----------
    count
        Number of rays.
    angle_increment
        Radians between neighbouring rays.
    time_increment
        Seconds between neighbouring rays as the message states; 0 where unknown.

    Returns
    -------
    times : Array
        (count,) seconds since the first ray.
    turns : int
        Mirror turns merged in the scan: 1, 2 or 4; 0 where the timing is unknown.

    """
    index = np.arange(count, dtype=float)
    if time_increment != 0.0:
        return index * time_increment, 1
    for step_deg, counts in INTERLACED.items():
        if count in counts and np.isclose(angle_increment, np.deg2rad(step_deg), rtol=1e-3):
            turns = round(1.0 / step_deg)
            return MIRROR_TURN * (index % turns + index * step_deg / 360.0), turns
    return np.zeros(count), 0


def make_scan(
    stamp_ns: int,
    ranges: ArrayLike,
    angle_min: float,
    angle_increment: float,
    time_increment: float,
    range_min: float = 0.0,
    range_max: float = np.inf,
    intensities: ArrayLike | None = None,
) -> Scan:
    """
    Build a Scan from the fields of a sensor_msgs/LaserScan.

    Returns
    -------
    Scan
        With float64 copies of the arrays; empty or wrong-length intensities become None.

    Raises
    ------
    ScanError
        If an angle, increment or limit is not finite where it must be, or the angle increment
        is zero with more than one ray.

    """
    r = np.array(ranges, dtype=float)
    numbers = {'angle_min': angle_min, 'angle_increment': angle_increment,
               'time_increment': time_increment, 'range_min': range_min}
    for name, value in numbers.items():
        if not np.isfinite(value):
            raise ScanError(f'scan at {stamp_ns} ns: {name} is {value}, must be finite')
    if angle_increment == 0.0 and len(r) > 1:
        raise ScanError(f'scan at {stamp_ns} ns: angle_increment is 0 with {len(r)} rays')
    if np.isnan(range_max) or range_max <= range_min:
        raise ScanError(f'scan at {stamp_ns} ns: range_max {range_max} m is not above '
                        f'range_min {range_min} m')
    times, _ = ray_times(len(r), angle_increment, time_increment)
    remission = None if intensities is None else np.array(intensities, dtype=float)
    if remission is not None and len(remission) != len(r):
        remission = None
    angles = angle_min + angle_increment * np.arange(len(r), dtype=float)
    return Scan(stamp_ns, r, angles, times, remission, range_min, range_max)


def stamp_ns(stamp: Any) -> int:
    """Return the integer nanoseconds of a builtin_interfaces/Time or ROS 1 time."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def scan_from_message(message: Any) -> Scan:
    """Return the Scan of a sensor_msgs/LaserScan message, read from a bag or by rclpy alike."""
    return make_scan(
        stamp_ns(message.header.stamp), np.frombuffer(message.ranges, dtype=np.float32),
        float(message.angle_min), float(message.angle_increment), float(message.time_increment),
        float(message.range_min), float(message.range_max),
        np.frombuffer(message.intensities, dtype=np.float32) if len(message.intensities) else None)


@dataclass
class ScanCounts:
    """What was met on one topic: good scans and those that had to be left out."""

    read: int = 0
    malformed: int = 0
    backwards: int = 0
    without_returns: int = 0


class ScanIntake:
    """
    Scans from the messages of one topic, in order; the same for a bag and for a live node.

    Parameters
    ----------
    topic
        Names the topic in warnings.
    counts
        Of what was met before, where there was anything; they go on.

    """

    def __init__(self, topic: str, counts: ScanCounts | None = None) -> None:
        """Start with nothing met."""
        self.counts = counts or ScanCounts()
        self._topic = topic
        self._last_ns: int | None = None

    def take(self, message: Any) -> Scan | None:
        """
        Return the scan of the next message.

        Returns
        -------
        Scan or None
            None for a malformed scan and for one whose stamp does not come after the one
            before it; both are counted.

        """
        try:
            scan = scan_from_message(message)
        except ScanError as error:
            self.counts.malformed += 1
            logger.warning('%s: %s; scan left out', self._topic, error)
            return None
        if self._last_ns is not None and scan.stamp_ns <= self._last_ns:
            self.counts.backwards += 1
            return None
        self._last_ns = scan.stamp_ns
        self.counts.read += 1
        self.counts.without_returns += not scan.valid.any()
        return scan
