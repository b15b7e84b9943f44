# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Laws of SE(2) and SE(3)."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stri_mapping import geometry

metres = st.floats(-1e3, 1e3)
turns = st.floats(-6.0, 6.0)          # within one turn, where log inverts exp
poses = st.tuples(metres, metres, turns).map(np.array)
angles = st.floats(-np.pi, np.pi)
# Products of numbers up to 1e3 with sines in double precision.
CLOSE = {'atol': 1e-9, 'rtol': 0.0}


@given(poses)
def test_a_pose_times_its_inverse_is_the_identity(pose):
    np.testing.assert_allclose(geometry.compose(pose, geometry.inverse(pose)), 0.0, **CLOSE)
    np.testing.assert_allclose(geometry.compose(geometry.inverse(pose), pose), 0.0, **CLOSE)


@given(poses, poses, poses)
def test_composition_is_associative(a, b, c):
    left = geometry.compose(geometry.compose(a, b), c)
    np.testing.assert_allclose(left, geometry.compose(a, geometry.compose(b, c)), **CLOSE)


@given(poses)
def test_log_inverts_exp(twist):
    # near a full turn sinc loses digits: 2 pi / (2 pi - 6) of them
    np.testing.assert_allclose(geometry.log(geometry.exp(twist)), twist, atol=1e-8)


@given(poses, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_motions_along_one_twist_add_up(twist, s, t):
    both = geometry.compose(geometry.exp(s * twist), geometry.exp(t * twist))
    np.testing.assert_allclose(both, geometry.exp((s + t) * twist), **CLOSE)


def test_exp_is_a_quarter_circle():
    radius = 3.0
    pose = geometry.exp([radius * np.pi / 2, 0.0, np.pi / 2])
    np.testing.assert_allclose(pose, [radius, radius, np.pi / 2], **CLOSE)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_rpy_are_fixed_axis_angles_and_come_back(roll, pitch, yaw):
    matrix = geometry.rotation_from_rpy(roll, pitch, yaw)
    expected = Rotation.from_euler('xyz', [roll, pitch, yaw]).as_matrix()
    np.testing.assert_allclose(matrix, expected, atol=1e-12)
    back = geometry.rotation_from_rpy(*geometry.rpy_from_rotation(matrix))
    np.testing.assert_allclose(back, matrix, atol=1e-12)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_quaternions_of_any_length_give_their_rotation(quat):
    expected = Rotation.from_quat(quat).as_matrix()
    np.testing.assert_allclose(geometry.rotation_from_quat(quat), expected, atol=1e-12)


@given(angles)
def test_yaw_survives_the_quaternion(yaw):
    back = geometry.yaw_from_quat(geometry.quat_from_yaw(yaw))
    assert abs(geometry.wrap_angle(back - yaw)) < 1e-12


def test_a_quaternion_without_direction_is_refused():
    with pytest.raises(ValueError, match='no direction'):
        geometry.rotation_from_quat([0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match='no direction'):
        geometry.rotation_from_quat([0.0, np.nan, 0.0, 1.0])


@given(st.floats(-100.0, 100.0))
def test_wrapped_angles_point_the_same_way(angle):
    wrapped = float(geometry.wrap_angle(angle))
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-12)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-12)


@given(st.lists(st.tuples(*[st.floats(-10.0, 10.0)] * 3), min_size=1, max_size=5))
def test_quaternions_of_angles_are_those_of_their_rotations(angles):
    quats = geometry.quat_from_rpy(angles)
    assert quats.shape == (len(angles), 4) and np.all(quats[:, 3] >= 0.0)
    for quat, rpy in zip(quats, angles):
        np.testing.assert_allclose(
            geometry.rotation_from_quat(quat), geometry.rotation_from_rpy(*rpy), atol=1e-12)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_rotations_survive_the_quaternion(quat):
    rotation = Rotation.from_quat(quat).as_matrix()
    back = geometry.quat_from_rotation(rotation)
    assert back[3] >= 0.0
    np.testing.assert_allclose(geometry.rotation_from_quat(back), rotation, atol=1e-12)
