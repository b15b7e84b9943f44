# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Mounts that are written, read back and replaced, and scans taken in: live as from a bag."""

from __future__ import annotations

from dataclasses import replace
import logging
from types import SimpleNamespace

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.scan import ScanIntake
from stri_mapping.vehicle import (
    default_vehicle_file,
    load_vehicle,
    remounted,
    Vehicle,
    write_vehicle,
)

# The upright pitches are where roll and yaw are one: a mount with its 0 degree ray straight down.
angles = st.floats(-np.pi, np.pi) | st.sampled_from([-np.pi / 2, np.pi / 2, np.pi])
triples = st.tuples(angles, angles, angles)


@given(rpy=triples, xyz=st.tuples(*3 * [st.floats(-5.0, 5.0)]))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_written_vehicle_is_read_back_as_it_was(rpy, xyz, tmp_path):
    known = load_vehicle(default_vehicle_file())
    scanners = (replace(known.horizontal, topic='/front/scan', frame='front'),
                replace(known.verticals[0], T_base_laser=geometry.transform(xyz, rpy)))
    write_vehicle(tmp_path / 'vehicle.yaml', Vehicle(scanners))
    for before, after in zip(scanners, load_vehicle(tmp_path / 'vehicle.yaml').scanners):
        # beside the poles of pitch, roll and yaw are known to sqrt(1e-16) at worst
        np.testing.assert_allclose(after.T_base_laser, before.T_base_laser, atol=1e-7)
        assert replace(after, T_base_laser=before.T_base_laser).__dict__ == before.__dict__


@pytest.mark.parametrize('shift, said', [(0.005, False), (0.02, True)])
def test_a_mount_from_tf_static_wins_and_only_a_real_difference_is_said(shift, said, caplog):
    scanner = load_vehicle(default_vehicle_file()).horizontal
    mount = scanner.T_base_laser + shift * np.eye(4, k=3)
    with caplog.at_level(logging.WARNING):
        new = remounted(scanner, 'front', mount)
    assert new.frame == 'front'
    np.testing.assert_array_equal(new.T_base_laser, mount)
    assert ('/tf_static is used' in caplog.text) is said


def message(stamp: int, angle_increment: float = 0.1) -> SimpleNamespace:
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=stamp)), angle_min=0.0,
        angle_increment=angle_increment, time_increment=0.0, range_min=0.0, range_max=10.0,
        ranges=np.full(3, 20.0 if stamp == 7 else 1.0, np.float32), intensities=np.zeros(0))


def test_the_intake_leaves_out_and_counts_what_cannot_be_used(caplog):
    intake = ScanIntake('/scan')
    taken = [intake.take(m) for m in (message(5), message(5), message(4), message(6, np.nan),
                                      message(6, 0.0), message(7))]
    assert [scan and scan.stamp_ns for scan in taken] == [5, None, None, None, None, 7]
    assert intake.counts.__dict__ == {
        'read': 2, 'malformed': 2, 'backwards': 2, 'without_returns': 1}
    assert caplog.text.count('/scan: scan at 6 ns') == 2
