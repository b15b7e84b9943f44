# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Write a virtual drive to disk: a bag, and in it the true surfaces and the scene's facts."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path

from stri_mapping.bag_io import TRUTH_TOPIC
from stri_mapping.bag_writer import BagWriter
from stri_mapping.simulation.drive import Drive, START_NS
from stri_mapping.simulation.mesh import write_ply

SURFACES, FACTS = 'surfaces.ply', 'scene.json'


def record(drive: Drive, path: Path, progress: Callable[[float], None] = lambda _: None) -> int:
    """
    Write a drive to a new directory.

    Beside metadata.yaml and the MCAP file it holds `surfaces.ply`, the surfaces that stand
    still, in odom, and `scene.json`, what is true of the scene.  The bag has the scans, logged
    when they arrive, the mounts on /tf_static, and on /ground_truth/odom the pose of base_link
    in odom with height, roll and pitch, and its velocity, every 10 ms.

    Parameters
    ----------
    drive
        What to drive.
    path
        Directory, new.
    progress
        Called with the seconds of the drive that are done.

    Returns
    -------
    int
        Number of scans written.

    Raises
    ------
    BagError
        If the directory exists already or cannot be made.

    """
    motion, times = drive.scene.motion, drive.truth_times()
    poses, twists = motion.at(times), motion.twist(times)
    truth_ns = [START_NS + round(1e9 * t) for t in times.tolist()]
    count, k = 0, 0
    with BagWriter(path) as bag:
        bag.static_transforms(drive.vehicle.scanners, START_NS)
        for timed in drive.scans():
            while k < len(times) and truth_ns[k] <= timed.arrival_ns:
                bag.odometry(TRUTH_TOPIC, truth_ns[k], poses[k], twists[k])
                k += 1
            bag.scan(timed.scanner, timed.scan, timed.arrival_ns)
            count += 1
            if count % 64 == 0:
                progress(1e-9 * (timed.arrival_ns - START_NS))
    write_ply(path / SURFACES, drive.scene.mesh)
    (path / FACTS).write_text(json.dumps(drive.facts(), indent=1) + '\n', encoding='utf-8')
    return count
