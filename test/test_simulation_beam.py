# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.simulation.beam import (
    echo_range,
    ECHOES,
    NEAR_SHARE,
    PATTERN,
    RISE,
    SUB_RAYS,
    sub_rays,
    TRIGGER,
)

returns = st.lists(st.tuples(st.floats(0.5, 60.0), st.floats(1e-6, 1.0)), min_size=1, max_size=7)


def one(distance, energy, echo='pulse'):
    ranges, _ = echo_range(np.array([distance], float), np.array([energy], float), echo)
    return float(ranges[0])


def waveform_crossing(distance, energy):
    """Sample the receiver's signal every 0.1 mm and look where it first reaches the trigger."""
    # the counter is calibrated on one surface: its own crossing is its distance
    z = np.linspace(-4.0, 4.0, 80001)
    calibration = z[np.searchsorted([0.5 * math.erfc(-v / math.sqrt(2)) for v in z], TRIGGER)]
    x = np.arange(min(distance) - 0.01, max(distance) + 0.01, 1e-4)
    signal = sum(e * np.array([0.5 * math.erfc(-((v - d) / RISE + calibration) / math.sqrt(2))
                               for v in x]) for d, e in zip(distance, energy))
    return x[np.searchsorted(signal, TRIGGER * sum(energy))]


@pytest.mark.parametrize('distance, energy', [
    ([5.0, 5.2], [0.5, 0.5]), ([5.0, 5.6], [0.3, 0.7]), ([8.0, 8.05, 8.1], [1.0, 1.0, 1.0]),
    ([3.0, 3.4], [0.15, 0.85]), ([10.0, 10.02], [0.2, 0.9])])
def test_range_is_where_the_summed_pulse_edges_reach_the_trigger(distance, energy):
    # sampled every 0.1 mm, and the root is found to 0.01 mm
    assert one(distance, energy) == pytest.approx(waveform_crossing(distance, energy), abs=2e-4)


@given(returns, st.floats(0.01, 100.0))
@settings(max_examples=200, deadline=None)
def test_range_lies_between_nearest_and_farthest_whatever_the_light(sub, gain):
    distance, energy = zip(*sub)
    x = one(distance, energy)
    assert min(distance) - 1e-4 <= x <= max(distance) + 1e-4
    assert one(distance[::-1], energy[::-1]) == pytest.approx(x, abs=1e-4)
    assert one(distance, [gain * e for e in energy]) == pytest.approx(x, abs=1e-4)


def test_partly_hit_edge_moves_from_far_to_near_as_more_of_it_is_hit():
    shares = np.linspace(0.0, 1.0, 21)
    near = [one([5.0, 5.5], [share, 1.0 - share]) for share in shares]
    assert near[0] == pytest.approx(5.5) and near[-1] == pytest.approx(5.0)
    assert np.all(np.diff(near) <= 1e-5)
    # between the two surfaces, and neither, where the share is just past the trigger
    assert 5.05 < one([5.0, 5.5], [TRIGGER + 0.05, 0.95 - TRIGGER]) < 5.45


def test_edge_before_a_far_wall_reads_beyond_itself_and_never_nearer():
    for share in (TRIGGER + 0.02, 0.3, 0.5, 0.8):
        x = one([5.0, 12.0], [share, 1.0 - share])
        # the plateau of the nearer pulse ends within three rise lengths of its calibrated edge
        assert 5.0 < x < 5.0 + 4.0 * RISE
    assert one([5.0, 12.0], [TRIGGER - 0.02, 1.02 - TRIGGER]) > 11.0


def test_grazing_incidence_pulls_to_the_near_side_and_more_the_flatter():
    pulls = []
    for degrees in (0.0, 45.0, 60.0, 70.0):
        angle = np.deg2rad(degrees)
        r = 8.0 / np.cos(angle)
        footprint = 0.008 + 0.00595 * r
        pulls.append(r - one(r + footprint * np.tan(angle) * PATTERN[:, 0], np.ones(SUB_RAYS)))
    assert pulls[0] == pytest.approx(0.0, abs=1e-9)
    assert 0.0 < pulls[1] < pulls[2] < pulls[3]
    # second order: z (sqrt(rise^2 + s^2) - rise) with s = r_foot tan / 2, z = 0.84
    assert pulls[1] == pytest.approx(0.84 * (np.hypot(RISE, 0.0377) - RISE), rel=0.2)


@pytest.mark.parametrize('echo', ECHOES)
def test_no_light_is_no_range(echo):
    ranges, energy = echo_range(np.full((2, SUB_RAYS), np.inf), np.zeros((2, SUB_RAYS)), echo)
    assert np.all(np.isinf(ranges)) and not energy.any()


@pytest.mark.parametrize(('echo', 'degrees', 'share'), [
    *(('middle', degrees, 0.0) for degrees in (0.0, 45.0, 75.0)),
    ('near side', 0.0, 0.0), ('near side', 45.0, 0.0), ('near side', 75.0, 0.5 - NEAR_SHARE)])
def test_simpler_receivers_read_the_middle_or_beyond_a_slant_the_near_side(echo, degrees, share):
    angle = np.deg2rad(degrees)
    r = 8.0 / np.cos(angle)
    footprint = 0.008 + 0.00595 * r
    distance = r + footprint * np.tan(angle) * PATTERN[:, 0]
    pull = r - one(distance, np.ones(SUB_RAYS), echo)
    assert pull == pytest.approx(share * np.ptp(distance), abs=1e-9)


def test_simpler_receivers_at_an_edge_read_between_its_surfaces():
    distance, light = np.full(SUB_RAYS, 5.0), np.ones(SUB_RAYS)
    distance[-2:] = 8.0
    assert one(distance, light, 'middle') == pytest.approx(5.0 + 3.0 * 2.0 / SUB_RAYS)
    assert one(distance, light, 'near side') == 5.0
    distance[0] = 8.0
    assert 5.0 < one(distance, light, 'near side') == distance.mean()


def test_pattern_has_the_second_moments_of_a_uniform_disc():
    assert np.allclose(PATTERN.mean(axis=0), 0.0, atol=1e-12)
    assert np.allclose(PATTERN.T @ PATTERN / SUB_RAYS, 0.25 * np.eye(2))


def test_sub_rays_start_where_the_mount_is_and_spread_by_the_divergence():
    rng = np.random.default_rng(1)
    poses = rng.uniform(-1.0, 1.0, (50, 6))
    angles = rng.uniform(-1.5, 1.5, 50)
    mount = geometry.transform((0.3, 0.6, 1.9), (0.4, -0.2, 1.1))
    origins, directions = sub_rays(poses, angles, mount, 0.016, 0.0119)
    for i in range(50):
        T = geometry.transform(poses[i, :3], poses[i, 3:]) @ mount
        ray = T[:3, :3] @ [np.cos(angles[i]), np.sin(angles[i]), 0.0]
        middle = i * SUB_RAYS
        assert np.allclose(directions[middle], ray) and np.allclose(origins[middle], T[:3, 3])
        around = slice(middle + 1, middle + SUB_RAYS)
        angle = np.arccos(directions[around] @ ray)
        assert np.allclose(np.tan(angle), np.tan(0.00595) * np.sqrt(7 / 12))
        start = origins[around] - T[:3, 3]
        assert np.allclose(start @ ray, 0.0, atol=1e-12)
        assert np.allclose(np.linalg.norm(start, axis=1), 0.008 * np.sqrt(7 / 12))
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0)
