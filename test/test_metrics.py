# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.errors import TrajectoryError
from stri_mapping.metrics import (
    align_best,
    align_start,
    displacements,
    Metric,
    path_metrics,
    speed_metrics,
    twist_metrics,
)
from stri_mapping.relations import read_relations, relation_errors, relation_metrics, Relations
from stri_mapping.trajectory import Trajectory

S = 10**9
poses = st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-3.0, 3.0))


def path(rows: np.ndarray, step: float = 0.1, start: float = 0.0) -> Trajectory:
    stamps = np.round((start + np.arange(len(rows)) * step) * 1e9).astype(np.int64)
    return Trajectory(stamps, np.asarray(rows, dtype=float))


def straight(speed: float, count: int = 101, step: float = 0.1, yaw: float = 0.0) -> Trajectory:
    t = np.arange(count) * step
    return path(np.column_stack([speed * t * np.cos(yaw), speed * t * np.sin(yaw),
                                 np.full(count, yaw)]), step)


def bend(seconds: float, twist: tuple[float, float, float], step: float = 0.05) -> Trajectory:
    t = np.arange(0.0, seconds, step)
    return path(geometry.exp(t[:, None] * np.array(twist)), step)


def values(metrics: list[Metric]) -> dict[str, float | None]:
    assert len({m.name for m in metrics}) == len(metrics)
    return {m.name: m.value for m in metrics}


def test_a_speed_two_percent_high_drifts_by_two_percent() -> None:
    # 10 s at 5 m/s: 50 m true, 51 m estimated
    got = values(path_metrics(straight(5.1), straight(5.0)))
    assert got['distance_m'] == pytest.approx(50.0)
    assert got['end_error_m'] == got['ate_start_max_m'] == pytest.approx(1.0)
    assert got['drift_percent'] == pytest.approx(2.0)
    # error 0, 0.01, ... 1.00 m: rms^2 = mean of (i/100)^2 = 201/600
    assert got['ate_start_rmse_m'] == pytest.approx(np.sqrt(201.0 / 600.0))
    # the best fit takes the mean out: variance of 0, 0.01, ... 1 is (101^2 - 1) / 12 / 100^2
    assert got['ate_fit_rmse_m'] == pytest.approx(np.sqrt((101**2 - 1) / 12.0) / 100.0)
    assert got['heading_rmse_deg'] == got['heading_end_deg'] == 0.0


def test_a_constant_turn_that_is_not_there_is_a_heading_error() -> None:
    t = np.arange(0.0, 10.05, 0.1)
    got = values(path_metrics(bend(10.05, (2.0, 0.0, 0.01), 0.1), straight(2.0)))
    assert got['heading_end_deg'] == pytest.approx(np.rad2deg(0.1))
    assert got['heading_rmse_deg'] == pytest.approx(np.rad2deg(0.01 * np.sqrt(np.mean(t**2))))
    # end of an arc of radius 200 m after 0.1 rad against 20 m straight on
    end = np.hypot(200.0 * np.sin(0.1) - 20.0, 200.0 * (1.0 - np.cos(0.1)))
    assert got['end_error_m'] == pytest.approx(end)


@given(poses, poses)
@settings(max_examples=50, deadline=None)
def test_errors_do_not_depend_on_where_the_frames_lie(a: tuple[float, ...],
                                                      b: tuple[float, ...]) -> None:
    truth, estimate = bend(6.0, (4.0, 0.0, 0.3)), bend(6.0, (4.1, 0.05, 0.31))
    moved = [Trajectory(t.stamps_ns, geometry.compose(np.array(m), t.poses))
             for t, m in ((truth, a), (estimate, b))]
    for metric in (path_metrics, speed_metrics):
        expected = metric(estimate, truth)
        for got, want in zip(metric(moved[1], moved[0]), expected):
            assert got.value == pytest.approx(want.value, abs=1e-9)


@given(poses)
@settings(max_examples=50, deadline=None)
def test_alignments_undo_a_motion(move: tuple[float, ...]) -> None:
    true = bend(6.0, (4.0, 0.0, 0.3)).poses
    moved = geometry.compose(np.array(move), true)
    np.testing.assert_allclose(align_start(moved, true), true, atol=1e-9)
    fitted = align_best(moved, true)
    np.testing.assert_allclose(fitted[:, :2], true[:, :2], atol=1e-9)
    np.testing.assert_allclose(geometry.wrap_angle(fitted[:, 2] - true[:, 2]), 0.0, atol=1e-9)


def test_the_best_fit_is_better_than_its_neighbours() -> None:
    true = bend(6.0, (4.0, 0.0, 0.3)).poses
    estimated = true + np.random.default_rng(0).normal(0.0, 0.2, true.shape)
    fitted = align_best(estimated, true)

    def cost(poses: np.ndarray) -> float:
        return float(np.sum((poses - true)[:, :2] ** 2))

    assert cost(fitted) < cost(align_start(estimated, true))
    for nudge in np.vstack([np.eye(3), -np.eye(3)]) * 1e-3:
        assert cost(geometry.compose(nudge, fitted)) > cost(fitted)


def test_truth_is_interpolated_but_not_over_gaps() -> None:
    truth = straight(5.0, 21, 0.5)                       # every half second
    sparse = Trajectory(np.delete(truth.stamps_ns, slice(5, 12)),
                        np.delete(truth.poses, slice(5, 12), axis=0))
    got = values(path_metrics(straight(5.0), sparse))
    assert got['ate_start_max_m'] == pytest.approx(0.0, abs=1e-9)
    late = Trajectory(truth.stamps_ns + 100 * S, truth.poses)
    with pytest.raises(TrajectoryError, match='no time in common: 100.000 to 110.000 s'):
        path_metrics(straight(5.0), late)
    with pytest.raises(TrajectoryError, match='no pose'):
        path_metrics(Trajectory(np.empty(0, np.int64), np.empty((0, 3))), truth)


def test_speed_errors_of_a_drive_with_a_stop() -> None:
    # 5 s at 4 m/s, 5 s still; the estimate is 1 % fast, and creeps at 5 mm/s when still
    t = np.arange(0.0, 10.001, 0.05)
    true = path(np.column_stack([4.0 * np.minimum(t, 5.0), 0 * t, 0 * t]), 0.05)
    x = 4.04 * np.minimum(t, 5.0) + 0.005 * np.maximum(t - 5.0, 0.0)
    got = values(speed_metrics(path(np.column_stack([x, 0 * t, 0 * t]), 0.05), true))
    assert got['speed_error_worst_percent'] == pytest.approx(1.0, abs=0.2)   # a window may brake
    assert got['speed_error_rms_percent'] == pytest.approx(1.0, abs=0.05)
    assert got['standing_speed_rms_mps'] == pytest.approx(0.005)
    assert got['standing_speed_max_mps'] == pytest.approx(0.005)
    # about half of the windows are off by 40 mm/s, half by 5 mm/s
    assert got['velocity_rmse_mps'] == pytest.approx(np.sqrt(0.5 * (0.04**2 + 0.005**2)), rel=0.03)


def test_a_drive_without_a_case_gives_none() -> None:
    got = values(speed_metrics(straight(0.5), straight(0.5)))
    assert got['speed_error_worst_percent'] is None
    assert got['standing_speed_rms_mps'] is None
    assert got['velocity_rmse_mps'] == pytest.approx(0.0, abs=1e-12)


def test_the_point_judged_matters_in_a_turn() -> None:
    # a point 0.5 m to the left of base_link is 0.5 * wz slower in a left turn, and a chord of
    # angle wz * 0.2 s is shorter than its arc by sinc
    turn = bend(5.0, (3.0, 0.0, 0.4))
    for point, arc in (((0.0, 0.0), 3.0), ((0.0, 0.5), 2.8)):
        step = displacements(turn, turn.stamps_ns[:10], 0.2, point)
        chord = arc * 0.2 * np.sinc(0.04 / np.pi)
        np.testing.assert_allclose(np.hypot(*step.T), chord, rtol=1e-9)
    late = displacements(turn, turn.stamps_ns[-1:], 0.2)
    assert np.all(np.isnan(late))


def test_twists_and_their_standard_deviations() -> None:
    truth = bend(20.0, (5.0, 0.2, 0.1), 0.01)
    stamps = truth.stamps_ns[50:-50:5]
    rng = np.random.default_rng(3)
    sigma = np.array([0.02, 0.01, 0.004])
    twist = [5.0, 0.2, 0.1] + rng.normal(size=(len(stamps), 3)) * sigma
    table = np.column_stack([twist, np.tile(sigma, (len(stamps), 1)), np.ones(len(stamps))])
    got = values(twist_metrics(stamps, table, truth))
    # 380 draws: the rms of each is good to 1/sqrt(2 * 380) = 4 %, and the share inside two
    # sigma, 95.4 %, to sqrt(.954 * .046 / 380) = 1.1 %; bounds are three times that
    assert len(stamps) == 380
    assert got['twist_rmse_mps'] == pytest.approx(np.hypot(0.02, 0.01), rel=0.12)
    assert got['twist_rmse_degps'] == pytest.approx(np.rad2deg(0.004), rel=0.12)
    for axis in ('vx', 'vy', 'wz'):
        assert got[f'within_2_sigma_{axis}_percent'] == pytest.approx(95.4, abs=3.3)
    table[:, 3:6] *= 0.5                                 # overconfident by two
    assert values(twist_metrics(stamps, table, truth))['within_2_sigma_vx_percent'] < 80.0
    outside = twist_metrics(truth.stamps_ns[:1], table[:1], truth)
    assert all(m.value is None for m in outside)


MOUNT = np.array([1.5, 0.25, np.pi / 2])


def relations_of(trajectory: Trajectory, pairs: list[tuple[int, int]]) -> Relations:
    laser = geometry.compose(trajectory.poses, MOUNT)
    first, second = np.array(pairs).T
    return Relations(trajectory.stamps_ns[first], trajectory.stamps_ns[second],
                     geometry.compose(geometry.inverse(laser[first]), laser[second]))


def test_relations_of_the_same_path_have_no_error() -> None:
    trajectory = bend(60.0, (1.0, 0.0, 0.2))
    relations = relations_of(trajectory, [(0, 10), (5, 900), (1199, 3)])
    translation, rotation = relation_errors(trajectory, relations, MOUNT)
    np.testing.assert_allclose(translation, 0.0, atol=1e-9)
    np.testing.assert_allclose(rotation, 0.0, atol=1e-9)
    wrong_mount, _ = relation_errors(trajectory, relations, [0.0, 0.0, 0.0])
    assert wrong_mount.min() > 0.1                       # the mount matters in a turn


def test_relation_errors_by_hand() -> None:
    trajectory = bend(60.0, (1.0, 0.0, 0.2))
    relations = relations_of(trajectory, [(0, 100), (0, 1100), (20, 30)])
    relations.poses[:] = geometry.compose(relations.poses, [[0.3, 0.4, 0.1], [0.0, 0.0, -0.2],
                                                            [0.0, 0.0, 0.0]])
    relations.second_ns[2] = 100 * S                     # not covered
    got = values(relation_metrics(trajectory, relations, MOUNT))
    assert (got['relations_local'], got['relations_all']) == (1.0, 2.0)
    assert got['relations_local_mean_m'] == pytest.approx(0.5)
    assert got['relations_local_mean_deg'] == pytest.approx(np.rad2deg(0.1))
    assert got['relations_all_mean_m'] == pytest.approx(0.25)
    assert got['relations_all_mean_deg'] == pytest.approx(np.rad2deg(0.15))


def test_stamps_rounded_to_microseconds_still_meet_their_scans(tmp_path: Path) -> None:
    stamps = np.array([976052857_337529983, 976052857_532998123, 976052899_728000449])
    trajectory = Trajectory(stamps, np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0.0]]))
    file = tmp_path / 'relations.csv'
    file.write_text('t1,t2,dx,dy,dyaw\n976052857.337530,976052857.532998,1.0,0.0,0.0\n'
                    '976052857.337529,976052899.728001,2.0,0.0,0.0\n')
    relations = read_relations(file)
    np.testing.assert_array_equal(relations.first_ns[0], 976052857_337530000)
    translation, _ = relation_errors(trajectory, relations, [0.0, 0.0, 0.0])
    # a microsecond of 1 m in 0.2 s
    np.testing.assert_allclose(translation, 0.0, atol=1e-5)


@pytest.mark.parametrize(('content', 'where'), [
    ('', 'relations.csv:1'), ('t1,t2\n', 'relations.csv:1'),
    ('t1,t2,dx,dy,dyaw\n1.0,2.0,3.0\n', 'relations.csv:2'),
    ('t1,t2,dx,dy,dyaw\n1.0,2.0,0,0,0\n1.0,2.0,0,nan,0\n', 'relations.csv:3'),
])
def test_faulty_relations_are_named(tmp_path: Path, content: str, where: str) -> None:
    file = tmp_path / 'relations.csv'
    file.write_text(content)
    with pytest.raises(TrajectoryError, match=where):
        read_relations(file)
    with pytest.raises(TrajectoryError, match='none.csv: No such file'):
        read_relations(tmp_path / 'none.csv')


def test_no_relation_covered_is_an_error() -> None:
    far = Relations(np.array([S]), np.array([2 * S]), np.zeros((1, 3)))
    with pytest.raises(TrajectoryError, match='covers none of the 1 relations'):
        relation_metrics(path(np.zeros((3, 3)), start=50.0), far, MOUNT)
