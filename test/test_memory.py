# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What nodes keep of a long drive: no more after ten minutes than after five and a half."""

from __future__ import annotations

import pickle
import tracemalloc

import numpy as np
import pytest

from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.recording.bag import Recording
from stri_mapping.recording.mcap_file import Topic
from stri_mapping.scan import Scan
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

VERTICALS = load_vehicle(default_vehicle_file()).verticals
# Of scans and of poses, nanoseconds; a scan's sweep, seconds; metres that the vehicle moves.
PERIOD, SWEEP, STEP = 100_000_000, 0.006, 0.8
ANGLES = np.deg2rad(np.arange(-89.5, 90.0, 3.0))


def street_scan(stamp_ns: int) -> Scan:
    """Return a scan of a road and a wall, seen from a roof 2 m above the road."""
    with np.errstate(divide='ignore'):
        road = np.where(ANGLES < 0.0, 2.0 / -np.sin(ANGLES), np.inf)
    ranges = np.minimum(road, 6.0 / np.cos(ANGLES))
    times = np.linspace(0.0, SWEEP, len(ANGLES))
    return Scan(stamp_ns, np.where(ranges < 40.0, ranges, np.inf), ANGLES, times)


def drive(aligner: FacadeAligner, rings: int, begin: int, end: int) -> None:
    """Drive straight on for some periods; the path comes a second late, points once a second."""
    for k in range(begin, end):
        for ring in range(rings):
            aligner.add_scan(ring, street_scan(k * PERIOD))
        aligner.add_poses([(k - 10) * PERIOD], [[STEP * (k - 10), 0.0, 0.0]])
        if k % 10 == 0:
            aligner.take_points()
            aligner.take_poses()


@pytest.mark.parametrize('rings', [1, 3])
def test_the_aligner_forgets_what_is_behind_it(rings):
    aligner = FacadeAligner(VERTICALS[:rings])
    drive(aligner, rings, 11, 3300)
    before = len(pickle.dumps(aligner))
    drive(aligner, rings, 3300, 6000)
    assert aligner.counts.points > 100_000
    # it keeps two minutes for scans that are late, and five of what walls told of yaw; then it
    # forgets; numbers get longer digits
    assert len(pickle.dumps(aligner)) < before + 2_000


def test_a_recording_forgets_the_files_it_has_completed(tmp_path):
    topics = [Topic(f'/topic_{k}', 'std_msgs/msg/String', b'string data\n', '', '[]')
              for k in range(15)]
    recording = Recording(tmp_path / 'bag', split_ns=50 * PERIOD)
    sizes = []
    tracemalloc.start()
    for k in range(601):
        for topic in topics:
            recording.write(topic, k * PERIOD, k * PERIOD, b'\0\1\0\0\1\0\0\0\0')
        recording.flush()
        if k in (100, 600):             # each the beginning of a file
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    recording.close()
    # ten more files, of each of which its name, span and counts are kept
    assert sizes[1] - sizes[0] < 10 * 3_000
