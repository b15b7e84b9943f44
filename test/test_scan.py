# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The scan model: ray times, masks, and what is refused."""

import numpy as np
import pytest

from stri_mapping.errors import ScanError
from stri_mapping.scan import make_scan, MIRROR_TURN, ray_times

DEG = np.pi / 180.0


def a_scan(ranges, **changes):
    fields = {'angle_min': -1.5, 'angle_increment': DEG, 'time_increment': 1e-5,
              'range_min': 0.1, 'range_max': 80.0, **changes}
    return make_scan(5, ranges, **fields)


def test_a_stated_time_increment_is_believed():
    times, turns = ray_times(361, 0.5 * DEG, 2e-5)
    assert turns == 1
    np.testing.assert_allclose(times, 2e-5 * np.arange(361))


@pytest.mark.parametrize(('count', 'step', 'turns'),
                         [(361, 0.5, 2), (201, 0.5, 2), (401, 0.25, 4)])
def test_merged_interlaced_scans_get_the_turn_and_sweep_of_each_ray(count, step, turns):
    times, merged = ray_times(count, step * DEG, 0.0)
    assert merged == turns
    index = np.arange(count)
    # ray i was taken in turn i mod turns, at bearing i * step of that turn
    np.testing.assert_allclose(times, MIRROR_TURN * (index % turns + index * step / 360.0))
    # every turn sweeps forward; neighbours in the merged scan are a turn apart
    for turn in range(turns):
        assert np.all(np.diff(times[turn::turns]) > 0.0)
    assert times[1] - times[0] == pytest.approx(MIRROR_TURN * (1.0 + step / 360.0))
    assert times.max() < MIRROR_TURN * turns


@pytest.mark.parametrize(('count', 'step'), [(181, 1.0), (181, 0.5), (541, 0.5), (1081, 0.25)])
def test_other_scans_without_timing_get_one_time(count, step):
    # 181 rays at half a degree are an LMS291-S14, which takes them in one turn; 541 are no LMS 2xx
    times, turns = ray_times(count, step * DEG, 0.0)
    assert turns == 0
    assert not times.any()


def test_the_mask_is_that_of_rep_117():
    scan = a_scan([1.0, np.inf, -np.inf, np.nan, 0.05, 81.0, 80.0, 0.1])
    assert scan.valid.tolist() == [True, False, False, False, False, False, True, True]
    np.testing.assert_array_equal(np.isfinite(scan.points).all(axis=1), scan.valid)


def test_finite_ranges_outside_the_limits_are_kept_as_they_are():
    assert a_scan([0.05, 81.0]).ranges.tolist() == [0.05, 81.0]


def test_points_lie_at_range_and_angle():
    scan = a_scan([2.0, 4.0], angle_min=np.pi / 2, angle_increment=np.pi / 2)
    np.testing.assert_allclose(scan.points, [[0.0, 2.0], [-4.0, 0.0]], atol=1e-12)


def test_input_arrays_are_copied():
    ranges = np.array([1.0, 2.0])
    scan = a_scan(ranges)
    ranges[0] = 9.0
    assert scan.ranges[0] == 1.0


def test_an_empty_scan_is_a_scan():
    scan = a_scan([])
    assert len(scan) == 0
    assert scan.end_ns == scan.stamp_ns


def test_the_last_ray_ends_the_scan():
    assert a_scan(np.ones(101)).end_ns == 5 + 1_000_000


def test_intensities_of_another_length_are_none():
    assert a_scan([1.0, 2.0], intensities=[7.0]).intensities is None
    assert a_scan([1.0, 2.0], intensities=[7.0, 8.0]).intensities.tolist() == [7.0, 8.0]


@pytest.mark.parametrize(('change', 'message'), [
    ({'angle_min': np.nan}, 'angle_min is nan'),
    ({'angle_increment': np.inf}, 'angle_increment is inf'),
    ({'angle_increment': 0.0}, 'angle_increment is 0 with 2 rays'),
    ({'time_increment': np.nan}, 'time_increment is nan'),
    ({'range_min': np.nan}, 'range_min is nan'),
    ({'range_max': np.nan}, 'range_max nan'),
    ({'range_max': 0.05}, 'not above'),
])
def test_contradictory_fields_are_refused_by_name(change, message):
    with pytest.raises(ScanError, match=message):
        a_scan([1.0, 2.0], **change)
