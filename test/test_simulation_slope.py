# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Virtual streets on a slope, and what the aligner makes of them."""

from __future__ import annotations

import numpy as np
import pytest

from stri_mapping.facade.points import GROUND
from stri_mapping.facade.push_broom import FacadeAligner

pytest.importorskip('embreex')
from stri_mapping.simulation.drive import Drive, make_drive, START_NS
from stri_mapping.simulation.scenes import Options


def street(slope: float, crossfall: float, seconds: float) -> Drive:
    return make_drive('street', Options(3, seconds, 1.8, slope=slope, crossfall=crossfall))


def test_a_vehicle_on_a_slope_sees_the_ground_and_traffic_as_on_the_level() -> None:
    drives = [street(slope, slope, 3.0) for slope in (0.0, 6.0)]
    assert drives[0].scene.movers
    for level, sloping in zip(*(drive.scans() for drive in drives)):
        if level.scanner.name == 'vertical_side':
            # down to the road; up the walls, which stay upright, ranges must differ
            down = (np.isfinite(level.scan.ranges) & np.isfinite(sloping.scan.ranges)
                    & (np.arange(181) < 60))
            off = np.abs(level.scan.ranges[down] - sloping.scan.ranges[down])
            # the same noise; a slope of 6 % is 0.2 % longer than its plan
            assert np.median(off) < 0.02
    t = np.linspace(0.0, 3.0, 50)
    a, b = (drive.scene.motion.at(t) for drive in drives)
    np.testing.assert_allclose(a[:, [0, 1, 5]], b[:, [0, 1, 5]], atol=1e-3)
    np.testing.assert_allclose(b[:, 2] - a[:, 2], 0.06 * (a[:, 0] + a[:, 1]), atol=1e-9)
    assert np.rad2deg(b[:, 4] - a[:, 4]).mean() == pytest.approx(-3.43, abs=0.3)
    assert np.rad2deg(b[:, 3] - a[:, 3]).mean() == pytest.approx(3.43, abs=0.3)


@pytest.mark.parametrize('slope, crossfall', [(5.0, -3.0), (0.0, 5.0)])
def test_slopes_leave_attitude_and_ground_as_they_are(slope: float, crossfall: float) -> None:
    drive = street(slope, crossfall, 6.0)
    aligner = FacadeAligner(drive.vehicle.verticals)
    rings = {s.name: ring for ring, s in enumerate(drive.vehicle.verticals)}
    for timed in drive.scans():
        if timed.scanner.name in rings:
            aligner.add_scan(rings[timed.scanner.name], timed.scan)
    path = drive.truth()
    aligner.add_poses(path.stamps_ns, path.poses)
    aligner.finish()
    points, (stamps, poses) = aligner.take_points(), aligner.take_poses()
    seconds = (stamps - START_NS) * 1e-9
    true = drive.scene.motion.at(seconds)
    body = street(0.0, 0.0, 6.0).scene.motion.at(seconds)
    settled = seconds > 2.0                      # walls tell the crossfall meanwhile
    # pitch is that from the road, roll that from upright
    assert np.rad2deg(np.std(poses[settled, 4] - body[settled, 4])) < 0.05
    assert np.rad2deg(np.abs(np.mean(poses[settled, 4] - body[settled, 4]))) < 0.05
    assert np.rad2deg(np.sqrt(np.mean((poses - true)[settled, 3] ** 2))) < 0.3
    ground = points.xyz[:, 2] < 0.1
    assert np.mean(points.label[ground & (points.stamps_ns - START_NS > 2e9)] == GROUND) > 0.95
