# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The pull of slanted footprints: learnt from walls, from streets, from what a keyframe sees."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from test_stri_parts import ANGLES, build, H, LEFT, look, prepared, WALL

from stri_mapping.stri import surfel
from stri_mapping.stri.config import JointConfig
from stri_mapping.stri.keyframe import merge
from stri_mapping.stri.range_error import CANDIDATES, RangeError, TURN
from stri_mapping.stri.slant import (
    DEEP,
    DIRECTION,
    FEWEST,
    KNEE,
    MOST,
    NEAR_SIDE,
    PIECE,
    pieces,
    PULLED,
    Slants,
    turned,
    WEIGHT,
)

SPEED = 8.0
# The scanner looks at the houses and moves along -y.
MOVING = np.arange(12)[:, None] * H * np.array([0.0, -SPEED, 0.0])
DEVICES = {
    'smooth': lambda q: 3.5e-5 * q ** 2 / (1.0 + q / DEEP),
    'near side': lambda q: np.where(q > KNEE, 5e-3 * q, 0.0),
    'no pull': lambda q: 0.0 * q,
}


def nothing():
    """No pieces of wall."""
    return np.empty((0, PIECE))


def houses(rng, length):
    """Segments of houses in line, 4 to 9 m wide, up to 0.4 m behind one another, 0.1 degrees."""
    walls, y = [], 40.0
    while y > -length - 40.0:
        width, x = rng.uniform(4.0, 9.0), 8.0 + rng.uniform(0.0, 0.4)
        askew = 0.5 * width * np.deg2rad(0.1) * rng.standard_normal()
        walls.append((x - askew, y, x + askew, y - width))
        y -= width
    return walls


def pieces_at(y, walls, device, rng):
    """Pieces of wall in a keyframe of 8 scans beginning at y, as a device reports ranges."""
    scans = []
    for k in range(8):
        t = 0.15 + k / 75.0
        ranges = look(np.array([0.0, y - SPEED * (t - 0.2), 0.0]), walls, 0.01, rng)
        slant = np.where(np.isfinite(ranges), ranges, 0.0) * np.abs(np.tan(ANGLES))
        scans.append(prepared(ranges - DEVICES[device](slant), start=t))
    rays = np.concatenate(scans)
    return pieces(*merge(rays, MOVING, H, 0.2), rays)


def turned_by_pull(error, pose, pull, step):
    """Move along a wall as the estimator would, its heading turned by what is not corrected."""
    # the wall stands across x, so its way is along y
    return pose + [0.0, step, TURN * (pull - error.value) * step]


def test_the_pull_of_slanted_footprints_is_learnt_from_a_wall():
    pull, rng, error = 4e-5, np.random.default_rng(7), RangeError(2e-5, 2e-5, 1.0)
    pose = np.zeros(3)
    for k in range(60):
        ranges = look(LEFT, WALL)
        slant = 8.0 * np.tan(ANGLES[1:-1]) / np.cos(ANGLES[1:-1])
        ranges[1:-1] -= pull * slant ** 2
        scans = [prepared(ranges + 0.01 * rng.standard_normal(181)) for _ in range(15)]
        surfels, count, _, _ = build(np.concatenate(scans))
        pose = turned_by_pull(error, pose, pull, -0.5)
        error.learn(surfels[:count], nothing, pose, 0.5 * k)
    # the prior holds it back where walls tell little; here they tell much
    assert error.value == pytest.approx(pull, rel=0.25)


@pytest.mark.parametrize('pull', [0.0, 4e-5])
@pytest.mark.parametrize('step', [-0.7, 0.7])
def test_the_pull_is_learnt_from_short_walls_in_line(pull, step):
    # every house 6 m long, out of line by 0.15 degrees, a parked car before every third
    rng, error, pose = np.random.default_rng(11), RangeError(2e-5, 2e-5, 1.0), np.zeros(3)
    house = np.deg2rad(0.15) * rng.standard_normal(100)
    car = np.deg2rad(1.5) * rng.standard_normal(100)
    for k in range(600):
        pose = turned_by_pull(error, pose, pull, step)
        at = abs(int(0.7 * k / 6.0))
        normal = (car if at % 3 == 0 else house)[at] + 0.005 * rng.standard_normal(80)
        surfels = np.zeros((80, surfel.SURFEL))
        along = np.linspace(-1.5, 1.5, 80)      # too short a piece to show a bend
        surfels[:, surfel.X] = 8.0
        surfels[:, surfel.Y] = along
        surfels[:, surfel.NX], surfels[:, surfel.NY] = -np.cos(normal), -np.sin(normal)
        error.learn(surfels, nothing, pose, 0.7 * k)
    # 0.15 degrees of 47 houses over 420 m leave a tenth of a degree in 100 m, or 0.7e-5
    assert error.value == pytest.approx(pull, abs=0.7e-5)
    assert abs(np.rad2deg(pose[2])) < 0.9        # 1.2 degrees and more had nothing been learnt


@pytest.mark.parametrize('seed', [1, 2, 3])
@pytest.mark.parametrize(('device', 'pull'), [
    ('smooth', 3.5e-5), ('near side', 0.0), ('no pull', 0.0)])
def test_one_moment_after_the_other_tells_what_slanted_footprints_do(device, pull, seed):
    rng, config = np.random.default_rng(seed), JointConfig()
    error = RangeError(config.pull, config.pull_sigma, config.pulls)
    assert 1e-5 < error.value < 2.5e-5       # it may be either, and is in between
    walls, surfels = houses(rng, 80.0), np.empty((0, surfel.SURFEL))
    for k in range(80):
        found = pieces_at(-1.0 * k, walls, device, rng)
        error.learn(surfels, lambda found=found: found, np.array([0.0, -1.0 * k, 0.0]), 1.0 * k)
    # 0.1 degrees from house to house, a dozen of them seen from 15 m ahead to 15 m behind, where
    # 1e-5 turns a wall by 0.09 degrees
    assert error.value == pytest.approx(pull, abs=1e-5)


def test_walls_are_asked_for_every_metre():
    error, asked = RangeError(3e-5, 1e-5, 0.5), []
    for k in range(41):
        error.learn(np.empty((0, surfel.SURFEL)), lambda: asked.append(1) or nothing(),
                    np.array([0.0, 0.25 * k, 0.0]), 0.25 * k)
    assert len(asked) == 11


@given(st.floats(2.0, 30.0), st.floats(0.1, 30.0))
def test_a_pull_turns_a_wall_by_the_slope_of_what_it_takes_off(d, x):
    def nearer(x):
        r = np.hypot(d, x)
        q = r * x / d
        return d / r * q * q / (1.0 + q / DEEP)

    step = 1e-4 * x
    slope = (nearer(x + step) - nearer(x - step)) / (2.0 * step)
    assert turned(d, x) == pytest.approx(slope, rel=1e-5)


def test_pieces_of_a_wall_are_turned_as_their_columns_say():
    rng = np.random.default_rng(5)
    straight_wall = [(8.0, 60.0, 8.0, -60.0)]
    for device, column, size in (('smooth', PULLED, 3.5e-5), ('near side', NEAR_SIDE, 5e-3)):
        found = pieces_at(0.0, straight_wall, device, rng)
        off = (found[:, DIRECTION] + 0.5 * np.pi) % np.pi - 0.5 * np.pi
        # where the near side begins there is a step in the wall
        use = np.abs(found[:, NEAR_SIDE]) == 1.0 if column == NEAR_SIDE else np.full(
            len(found), True)
        w = found[use, WEIGHT]
        told = (w * off[use] * found[use, column]).sum() / (w * found[use, column] ** 2).sum()
        assert use.sum() > 30 and told == pytest.approx(size, rel=0.15)


@settings(max_examples=30)
@given(st.integers(0, 1000), st.floats(-np.pi, np.pi))
def test_one_look_says_little_and_the_same_however_the_scanner_is_turned(seed, turn):
    rng = np.random.default_rng(seed)
    found = np.empty((200, PIECE))
    found[:, PULLED], found[:, NEAR_SIDE] = rng.uniform(-300.0, 300.0, 200), 0.0
    found[:, DIRECTION] = 0.3 + 6e-5 * found[:, PULLED] + 1e-3 * rng.standard_normal(200)
    found[:, WEIGHT] = 1e5
    elsewhere = found.copy()
    elsewhere[:, DIRECTION] += turn
    logs = []
    for look_at in (found, elsewhere):
        slants = Slants(CANDIDATES, 3e-5, 1.5e-5, 0.5)
        before = slants.log()
        slants.add(look_at, 0.0)
        logs.append(slants.log() - before)
    # MOST, and what the spline between the pulls that are weighed overshoots
    assert np.ptp(logs[0]) < 1.5 * MOST and np.argmax(logs[0]) > np.searchsorted(CANDIDATES, 4e-5)
    np.testing.assert_allclose(logs[0], logs[1], atol=0.05)


def test_too_few_pieces_say_nothing():
    slants = Slants(CANDIDATES, 3e-5, 1.5e-5, 0.5)
    before = slants.log()
    slants.add(np.ones((FEWEST - 1, PIECE)), 0.0)
    np.testing.assert_array_equal(slants.log(), before)
