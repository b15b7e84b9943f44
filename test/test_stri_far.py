# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What tells the way along a bare wall: faces far ahead, and what is painted on it."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from test_stri_estimator import run
from test_stri_parts import ANGLES, build, COLUMNS, H, LEFT, look, prepared, WALL

from stri_mapping import geometry
from stri_mapping.scan import Scan
from stri_mapping.stri.edges import REACH
from stri_mapping.stri.surfel import FACE_SCATTER, NX, NY, X, Y

MOUNT = geometry.transform([0.0, 0.0, 1.2], [0.0, 0.0, np.pi / 2])
PERIOD = 1.0 / 75.0
NOISE, SPECKLE = 0.01, 0.03           # metres; share of the brightness
BARE = 90.0                           # metres between the columns at either end of a wall


def row(begin, end):
    """Faces (n, 4) across the way, 0.6 m wide, every 6 m beside it."""
    return [(x, 6.3, x, 6.9) for x in np.arange(begin, end, 6.0)]


def merged(speed, walls, rng):
    """Keyframe at 0.2 s of the 15 turns around it, at a speed along x."""
    knots = LEFT + np.arange(8)[:, None] * H * np.array([speed, 0.0, 0.0])
    times = 0.2 + PERIOD * np.arange(-7, 8)
    at = [LEFT + np.array([speed * (t + H), 0.0, 0.0]) for t in times]
    scans = [prepared(look(pose, walls, NOISE, rng), start=t) for pose, t in zip(at, times)]
    return build(np.concatenate(scans), knots, stride=1)


@pytest.mark.parametrize('speed', [-8.0, 2.0, 5.0])
def test_faces_in_a_row_far_ahead_face_the_scanner(speed):
    way = np.sign(speed)
    walls = WALL + [(way * x, y0, way * x, y1) for x, y0, _, y1 in row(40.0, 60.0)]
    surfels, count, _, _ = merged(speed, walls, np.random.default_rng(4))
    ahead = -way * surfels[:count, Y]         # the scanner looks left, the way is its -y
    far = surfels[:count][ahead > 30.0]
    assert len(far) > 10
    assert np.all(np.abs(far[:, NY]) > 0.9)
    # on one of the faces, to the noise of a mean of four rays and more: six of its deviations
    there = way * (speed * (0.2 + H)) + ahead[ahead > 30.0]
    assert np.abs((there - 40.0 + 3.0) % 6.0 - 3.0).max() < 6.0 * 2.0 * NOISE / np.sqrt(4.0)


@pytest.mark.parametrize('speed', [0.0, 0.5, 2.0, 8.0])
def test_a_wall_that_is_grazed_is_no_face(speed):
    surfels, count, _, _ = merged(speed, WALL, np.random.default_rng(5))
    # only squarely, to within its own few metres, is the wall a surface at all
    assert np.all(surfels[:count, NX] < -0.9)


def drive(walls, seconds, far, brightness=None, seed=0):
    """Scans of a drive at 5 m/s and a wave of 1 m/s, and the way at their stamps."""
    rng, scans, way = np.random.default_rng(seed), [], []
    for k in range(round(seconds / PERIOD)):
        t = k * PERIOD
        x = 5.0 * t + 2.0 * (1.0 - np.cos(0.5 * t))
        ranges = look(np.array([x, 0.0, np.pi / 2]), walls, NOISE, rng)
        light = None
        if brightness is not None:
            light = brightness(x, ranges) * (1.0 + SPECKLE * rng.standard_normal(len(ranges)))
        ranges[ranges > far] = np.inf
        scans.append(Scan(round(1e9 * t), ranges, ANGLES, np.zeros(len(ANGLES)), light,
                          range_max=80.0))
        way.append(x)
    return scans, np.array(way)


def test_columns_at_both_ends_tell_the_way_along_a_bare_wall():
    near = [s for s in COLUMNS if s[0] < 10.0]
    beyond = [(s[0] + BARE + 48.0, s[1], s[2] + BARE + 48.0, s[3]) for s in COLUMNS]
    scans, way = drive([(-60.0, 8.0, 160.0, 8.0)] + near + beyond, 15.0, 60.0)
    _, final = run(MOUNT, scans)
    off = np.abs(np.array([e.pose[0] for e in final]) - way)
    # faces are known to their scatter, and are passed on once, from those behind to those ahead;
    # blind, the wave of the speed alone would take it metres off
    assert off.max() < 2.0 * FACE_SCATTER


def painted(seed):
    """What a wall sends back, by the place where it is met: panels 1 to 4 m wide."""
    rng = np.random.default_rng(seed)
    ends = np.cumsum(rng.uniform(1.0, 4.0, 120)) - 60.0
    level = rng.uniform(15.0, 80.0, len(ends) + 1)

    def brightness(x, ranges):
        met = x - 8.0 * np.tan(np.clip(ANGLES, -1.5, 1.5))
        spot = 0.012 * np.minimum(ranges, 80.0) / np.maximum(np.cos(ANGLES), 0.1)
        across = met + np.linspace(-0.5, 0.5, 9)[:, None] * spot
        return level[np.searchsorted(ends, across)].mean(axis=0)

    return brightness


@pytest.mark.parametrize('seed', range(3))
def test_paint_tells_the_way_along_a_bare_wall(seed):
    walls = [(-60.0, 8.0, 160.0, 8.0)] + [s for s in COLUMNS if s[0] < 10.0]
    # nothing is seen further than 25 m: after 30 m the wall is all there is
    scans, way = drive(walls, 15.0, 25.0, painted(seed), seed)
    _, final = run(MOUNT, scans)
    # what follows the last keyframe is extrapolated
    bare = (way > 35.0) & (np.arange(len(way)) < len(way) - H / PERIOD)
    off = np.array([e.pose[0] for e in final]) - way
    # an edge is known to 1 cm or so, and ten of them stand between now and 10 m before
    assert np.abs(off).max() < 0.1
    assert not any(e.degenerate for e, b in zip(final, bare) if b)
    _, blind = run(MOUNT, [Scan(s.stamp_ns, s.ranges, s.angles, s.times, range_max=80.0)
                           for s in scans])
    assert np.mean([e.degenerate for e, b in zip(blind, bare) if b]) > 0.9


def brightness_of(at, levels, width):
    """Brightness (181,) of a wall 8 m ahead with a step, blurred over a width."""
    t = 8.0 * np.tan(ANGLES) - at
    return levels[0] + (levels[1] - levels[0]) * np.clip(t / width + 0.5, 0.0, 1.0)


def edges_of(light, rng):
    """Edges of a keyframe of 15 turns, each shifted by a tenth of a ray, before a plain wall."""
    rays = []
    for k in range(15):
        ranges = look(np.zeros(3), [(8.0, -60.0, 8.0, 60.0)], NOISE, rng)
        # a small sideways move between turns, so that rays fall between each other's places
        given = light(0.014 * (k - 7)) * (1.0 + SPECKLE * rng.standard_normal(181))
        scan = prepared(ranges, given, 0.2 + PERIOD * (k - 7))
        rays.append(scan)
    # the scanner's way along the wall as the spline has it
    speed = 0.014 / PERIOD
    knots = np.arange(8)[:, None] * H * np.array([0.0, speed, 0.0])
    return build(np.concatenate(rays), knots, stride=1)[3]


@settings(max_examples=30, deadline=None)
@given(at=st.floats(-1.0, 1.0), dark=st.floats(5.0, 40.0), contrast=st.floats(1.5, 5.0),
       rising=st.booleans(), seed=st.integers(0, 1000))
def test_an_edge_is_found_where_the_brightness_steps(at, dark, contrast, rising, seed):
    levels = (dark, dark * contrast) if rising else (dark * contrast, dark)
    edges = edges_of(lambda moved: brightness_of(at - moved, levels, 0.1),
                     np.random.default_rng(seed))
    assert len(edges)
    # 0.6 m of face hold n points; the integral and both levels carry their speckle
    n = 15 * 2.0 * REACH / (8.0 * (ANGLES[1] - ANGLES[0]))
    step = abs(levels[1] - levels[0])
    sigma = SPECKLE * max(levels) / step * 2.0 * REACH / np.sqrt(n / 2.0)
    # one spacing of points besides: no better is a step between two of them known
    assert abs(np.median(edges[:, Y]) - at) < 4.0 * sigma + 2.0 * REACH / n
    assert np.all(edges[:, NY] * (1.0 if rising else -1.0) > 0.99)       # from dark to bright
    np.testing.assert_allclose(edges[:, X], 8.0, atol=5.0 * NOISE)


@pytest.mark.parametrize('light', [
    lambda moved: np.full(181, 50.0),
    lambda moved: 50.0 + 4.0 * (8.0 * np.tan(np.clip(ANGLES, -1.2, 1.2)) + moved),    # a slope
    lambda moved: np.zeros(181),        # reflector levels, where there is no reflector
    lambda moved: np.full(181, np.nan),
], ids=['plain', 'slope', 'zero', 'none'])
def test_no_edge_is_found_where_there_is_none(light):
    assert len(edges_of(light, np.random.default_rng(9))) == 0
