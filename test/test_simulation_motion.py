# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.simulation import motion, route
from stri_mapping.simulation.motion import KNOT, Motion, Path
from stri_mapping.simulation.ride import drive, Ride


def winding(vibration, seed=3):
    rng = np.random.default_rng(seed)
    speed = motion.random_speed(motion.times(12.0), rng, 3.0, 8.0)
    path = Path([(15.0, 0.0), *motion.lane_change(25.0, 2.0), (17.0, 1.4), (40.0, 0.0)])
    return drive(path, motion.distance_along(speed), rng, vibration)


@pytest.mark.parametrize('vibration', [0.0, 1.0])
def test_twist_is_what_takes_one_pose_to_the_next(vibration):
    moving, h = winding(vibration), 1e-4
    for t in np.linspace(0.5, 11.5, 23):
        before, after = (geometry.transform(p[:3], p[3:])
                         for p in moving.at(np.array([t - h, t + h])))
        step = np.linalg.inv(before) @ after
        twist = moving.twist(np.array([t]))[0]
        # central differences: the error is of order h^2 times jerk, plus half a step's turn
        assert np.allclose(step[:3, 3] / (2 * h), twist[:3], atol=2e-3)
        turn = 0.5 * np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0],
                               step[1, 0] - step[0, 1]])
        assert np.allclose(turn / (2 * h), twist[3:], atol=1e-4)


def test_rear_axle_never_slips_sideways():
    moving = winding(0.0)
    twist = moving.twist(np.linspace(0.2, 11.8, 200))
    # only the interpolation between knots 10 ms apart is left: (8 m/s 10 ms)^2 times curvature
    assert np.abs(twist[:, 1]).max() < 1e-3
    assert twist[:, 0].min() > 2.9


def test_paper_profile_is_170_m_at_10_to_30_kmh():
    t = motion.times(34.0)
    speed = motion.paper_speed(t, 170.0, 34.0)
    assert motion.distance_along(speed)[3400] == pytest.approx(170.0, abs=1e-3)
    assert 10.0 / 3.6 < speed.min() < 12.0 / 3.6 and 29.0 / 3.6 < speed.max() < 31.0 / 3.6


def test_lane_change_ends_parallel_and_to_the_side():
    x, y, yaw = Path(motion.lane_change(30.0, 3.0)).at(np.array([30.0]))[0]
    assert yaw == pytest.approx(0.0, abs=1e-12) and y == pytest.approx(3.0, rel=0.02)


def test_path_keeps_its_arc_length_and_goes_straight_on_beyond_its_ends():
    path = Path([(20.0, 0.7), (30.0, -2.0)])
    s = np.linspace(-5.0, 60.0, 6501)
    steps = np.hypot(*np.diff(path.at(s)[:, :2], axis=0).T)
    # a chord of 1 cm at a radius of 3 m is 5e-9 m shorter than its arc
    assert np.allclose(steps, 0.01, atol=1e-7)


def test_loop_returns_to_its_start():
    half, side = route.Leg(100.0, 0.5 * np.pi), route.Leg(150.0, 0.5 * np.pi)
    legs = [half, side, route.Leg(200.0, 0.5 * np.pi), side, route.Leg(100.0)]
    path, corners = route.path_along(legs)
    assert np.allclose(path.at(np.array([path.length]))[0], [0.0, 0.0, 2.0 * np.pi], atol=1e-6)
    assert len(corners) == 4


def test_corners_are_taken_slowly_and_the_end_is_reached():
    path, corners = route.path_along([route.Leg(100.0, 1.5), route.Leg(100.0)])
    s = route.distance_on(path, corners, np.random.default_rng(1), 4.0, 8.0)
    speed = np.gradient(s, KNOT)
    assert speed[np.abs(s - corners[0]) < 1.0].max() < 3.5
    assert s[-1] == pytest.approx(path.length, abs=8.0 * KNOT)
    # sideways acceleration of a road vehicle
    yaw = path.at(s)[:, 2]
    assert np.abs(speed * np.gradient(yaw, KNOT)).max() < 4.0


def test_speed_through_points_stands_still_at_zero_and_has_no_jumps():
    t = motion.times(20.0)
    v = motion.speed_through(t, [(0.0, 5.0), (5.0, 5.0), (8.0, 0.0), (12.0, 0.0), (16.0, -3.0),
                                 (20.0, -3.0)])
    assert np.all(np.abs(v[(t > 8.5) & (t < 11.5)]) < 1e-12)
    assert np.abs(np.diff(v, 2)).max() / KNOT**2 < 10.0        # m/s^3


def test_body_rolls_pitches_and_heaves_as_a_car_does():
    t = np.linspace(1.0, 11.0, 1000)
    still = winding(0.0).at(t)
    assert not still[:, 2:5].any()
    moving = winding(1.0).at(t)
    roll, pitch = np.rad2deg(moving[:, 3:5].std(axis=0))
    assert 0.05 < roll < 2.0 and 0.05 < pitch < 1.0
    assert 0.0005 < moving[:, 2].std() < 0.03
    assert np.allclose(winding(2.0).at(t)[:, 2:5], 2.0 * moving[:, 2:5], atol=1e-9)


def test_braking_lowers_the_nose_and_a_left_turn_leans_to_the_right():
    rng, smooth = np.random.default_rng(1), Ride(roughness=0.0, buzz=0.0)
    braking = motion.distance_along(np.maximum(10.0 - 2.0 * motion.times(4.0), 0.1))
    pitch = drive(Path([(60.0, 0.0)]), braking, rng, 1.0, smooth).at(np.array([3.0]))[0, 4]
    assert pitch == pytest.approx(2.0 * smooth.dive, rel=0.1)        # nose down is positive
    turning = motion.distance_along(np.full(len(motion.times(12.0)), 5.0))
    bend = drive(Path([(100.0, 3.0)]), turning, rng, 1.0, smooth).at(np.array([10.0]))[0]
    # raised cosine: twice the mean curvature in its middle
    assert bend[3] == pytest.approx(smooth.lean * 25.0 * 0.06, rel=0.05)


def test_motion_passes_through_its_knots():
    poses = np.random.default_rng(2).normal(size=(40, 6))
    assert np.allclose(Motion(poses).at(np.arange(40) * KNOT), poses)
