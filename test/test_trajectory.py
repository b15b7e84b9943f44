# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Interpolation between poses and the TUM format."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.errors import TrajectoryError
from stri_mapping.trajectory import constant_speed, read_tum, Trajectory, tum_line, write_tum

SECOND = 10**9
EPOCH = 1_400_843_350 * SECOND


def on_a_circle(n=11, speed=5.0, rate=0.3):
    t = np.arange(n)
    poses = geometry.exp(t[:, None] * np.array([speed, 0.0, rate]))
    return Trajectory(EPOCH + t * SECOND, poses)


def test_a_constant_twist_is_interpolated_exactly():
    trajectory = on_a_circle()
    t = np.linspace(0.0, 10.0, 97)
    expected = geometry.exp(t[:, None] * np.array([5.0, 0.0, 0.3]))
    stamps = EPOCH + np.round(t * SECOND).astype(np.int64)
    # stamps are whole nanoseconds: 5 nm at 5 m/s, and doubles of 1e10 ns differences
    np.testing.assert_allclose(trajectory.at(stamps), expected, atol=1e-8)


def test_nothing_is_known_outside_the_span():
    trajectory = on_a_circle()
    outside = trajectory.at([EPOCH - 1, EPOCH + 10 * SECOND + 1])
    assert np.isnan(outside).all()
    assert np.isfinite(trajectory.at([EPOCH, EPOCH + 10 * SECOND])).all()


@given(st.permutations(range(20)))
def test_the_order_of_the_questions_does_not_matter(order):
    trajectory = on_a_circle()
    stamps = EPOCH + np.linspace(0, 10 * SECOND, 20).astype(np.int64)
    np.testing.assert_array_equal(trajectory.at(stamps[list(order)]),
                                  trajectory.at(stamps)[list(order)])


def test_one_pose_is_known_at_its_own_time_only():
    trajectory = Trajectory(np.array([EPOCH]), np.array([[1.0, 2.0, 3.0]]))
    np.testing.assert_array_equal(trajectory.at([EPOCH])[0], [1.0, 2.0, 3.0])
    assert np.isnan(trajectory.at([EPOCH + 1])).all()
    assert np.isnan(Trajectory(np.zeros(0, np.int64), np.zeros((0, 3))).at([EPOCH])).all()


def test_stamps_must_increase():
    with pytest.raises(TrajectoryError, match='increase'):
        Trajectory(np.array([2, 2]), np.zeros((2, 3)))
    with pytest.raises(TrajectoryError, match='shape'):
        Trajectory(np.array([1, 2]), np.zeros((3, 3)))


def test_tum_keeps_nanoseconds_and_heading(tmp_path):
    trajectory = on_a_circle()
    odd = Trajectory(trajectory.stamps_ns + 123_456_789, trajectory.poses)
    write_tum(tmp_path / 'a.tum', odd)
    back = read_tum(tmp_path / 'a.tum')
    np.testing.assert_array_equal(back.stamps_ns, odd.stamps_ns)
    # nine decimals, the heading by its quaternion
    np.testing.assert_allclose(back.poses, odd.poses, atol=3e-9)
    first = (tmp_path / 'a.tum').read_text().splitlines()[0]
    assert first == tum_line(int(odd.stamps_ns[0]), odd.poses[0])
    assert first.split()[0] == '1400843350.123456789'


@pytest.mark.parametrize('line', ['1.0 2 3', 'x 0 0 0 0 0 0 1', '1.0 0 nan 0 0 0 0 1'])
def test_a_bad_line_is_named(tmp_path, line):
    path = tmp_path / 'bad.tum'
    path.write_text('# comment\n1.0 0 0 0 0 0 0 1\n' + line + '\n')
    with pytest.raises(TrajectoryError, match=r'bad\.tum:3'):
        read_tum(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TrajectoryError, match='absent'):
        read_tum(tmp_path / 'absent.tum')


def test_constant_speed_keeps_the_ends_and_nothing_else():
    trajectory = on_a_circle()
    straight = constant_speed(trajectory)
    np.testing.assert_allclose(straight.poses[[0, -1], :2], trajectory.poses[[0, -1], :2])
    steps = np.diff(straight.poses[:, :2], axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-9)
    chord = np.hypot(*(trajectory.poses[-1] - trajectory.poses[0])[:2])
    assert straight.distance == pytest.approx(chord)
