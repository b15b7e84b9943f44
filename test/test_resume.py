# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A path that goes on after a crash: where it left off, in odom, without a jump."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.motion_file import MotionWriter
from stri_mapping.resume import COASTING, interruption, placed
from stri_mapping.stri.estimate import Estimate
from stri_mapping.summary import pose_gaps
from stri_mapping.trajectory import read_tum

T0, PERIOD = 1_767_225_600_000_000_000, 13_320_000
TWIST = np.array([5.0, 0.0, 0.1])


def estimates(count: int, first: int = 0) -> list[Estimate]:
    """Return a curve at 5 m/s and 0.1 rad/s, of which every tenth pose is degenerate."""
    return [Estimate(T0 + i * PERIOD, geometry.exp(TWIST * i * PERIOD * 1e-9), np.eye(3), TWIST,
                     1e-4 * np.eye(3), 0.1 if i % 10 == 9 else 0.9, i % 10 == 9)
            for i in range(first, first + count)]


@pytest.mark.parametrize('torn', ['', '1767225601.0', '1767225601.000000000 1.0 2.0'])
def test_it_goes_on_after_the_last_whole_pose(torn, tmp_path):
    with MotionWriter(tmp_path) as writer:
        writer.write(estimates(100))
    with (tmp_path / 'trajectory.tum').open('a', encoding='utf-8') as file:
        file.write(torn)                    # a crash in the middle of a line
    before = interruption(tmp_path)
    assert before is not None
    np.testing.assert_array_equal(before.stamps_ns, [e.stamp_ns for e in estimates(100)])
    # files have nine and six decimals
    np.testing.assert_allclose(before.pose, estimates(100)[-1].pose, atol=1e-8)
    np.testing.assert_allclose(before.twist, TWIST, atol=1e-6)
    with MotionWriter(tmp_path, append=True) as writer:
        writer.write(estimates(100, first=400))
        facts = writer.facts()
    assert facts['poses'] == len(read_tum(tmp_path / 'trajectory.tum')) == 200
    assert len(facts['degenerate_stretches']) == 20     # of both parts, and the gap is none
    gap, = pose_gaps(read_tum(tmp_path / 'trajectory.tum').stamps_ns)
    assert gap == (T0 + 99 * PERIOD, T0 + 400 * PERIOD)


def test_files_of_unequal_length_are_cut_to_what_they_have_in_common(tmp_path):
    with MotionWriter(tmp_path) as writer:
        writer.write(estimates(50))
    path = tmp_path / 'velocity.csv'
    lines = path.read_text(encoding='utf-8').splitlines(keepends=True)
    path.write_text(''.join(lines[:31]) + lines[31][:20], encoding='utf-8')
    before = interruption(tmp_path)
    assert before is not None
    assert len(before.stamps_ns) == len(read_tum(tmp_path / 'trajectory.tum')) == 30


def test_where_nothing_was_written_nothing_is_resumed(tmp_path):
    assert interruption(tmp_path) is None
    MotionWriter(tmp_path).close()
    assert interruption(tmp_path) is None


def test_meanwhile_the_vehicle_kept_its_velocity_but_not_for_ever(tmp_path):
    with MotionWriter(tmp_path) as writer:
        writer.write(estimates(100))
    before = interruption(tmp_path)
    assert before is not None
    later = estimates(1, first=300)[0]
    np.testing.assert_allclose(before.pose_at(later.stamp_ns), later.pose, atol=1e-4)
    stamp = int(before.stamps_ns[-1])
    np.testing.assert_array_equal(before.pose_at(stamp + round(1e9 * COASTING)),
                                  before.pose_at(stamp + round(9e9 * COASTING)))


coordinates = st.floats(-1e3, 1e3)
poses = st.tuples(coordinates, coordinates, st.floats(-3.0, 3.0)).map(np.array)


@given(start=poses, pose=poses)
def test_placed_estimates_move_as_they_did_before(start, pose):
    estimate = Estimate(T0, pose, np.diag([1.0, 4.0, 0.1]), TWIST, np.eye(3), 1.0, False)
    moved = placed(estimate, start)
    back = geometry.compose(geometry.inverse(start), moved.pose)
    np.testing.assert_allclose(back[:2], pose[:2], atol=1e-6)
    np.testing.assert_array_equal(moved.twist, TWIST)
    # a rotation leaves the size of an uncertainty as it is
    np.testing.assert_allclose(np.linalg.eigvalsh(moved.pose_covariance), [0.1, 1.0, 4.0])


@given(st.lists(st.integers(10, 20), min_size=5, max_size=40), st.integers(600, 5000))
def test_a_gap_is_what_is_longer_than_half_a_second(steps_ms, gap_ms):
    middle = len(steps_ms) // 2
    stamps = np.cumsum([*steps_ms[:middle], gap_ms, *steps_ms[middle:]]) * 10**6
    assert pose_gaps(stamps) == ([(int(stamps[middle - 1]), int(stamps[middle]))])
    assert pose_gaps(np.cumsum(steps_ms) * 10**6) == []
