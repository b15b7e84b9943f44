# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator's parts: surfaces, spline, lines, residuals, proposals, trust."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.scan import Scan
from stri_mapping.stri import keyframe, pairs, surfel
from stri_mapping.stri.edges import EDGES
from stri_mapping.stri.estimate import of_base, speed_sigma
from stri_mapping.stri.proposal import Profile, SlopeSearch
from stri_mapping.stri.range_image import RangeImage, RangeImageLog
from stri_mapping.stri.rays import prepare_rays, RAY
from stri_mapping.stri.recovery import Recovery
from stri_mapping.stri.segmentation import Segmenter, UNLABELLED
from stri_mapping.stri.sight import count_left, count_through
from stri_mapping.stri.spline import pose_at, velocity_at
from stri_mapping.stri.trust import (
    LABELS,
    MOVES,
    NEW,
    STEADY,
    Trust,
    USUAL_ROUNDS,
    WAYWARD,
    WITNESS,
)

ANGLES = np.deg2rad(np.arange(-90.0, 91.0))
H = 0.1


def look(pose, walls, noise=0.0, rng=None):
    """Ranges (181,) from a pose to segments (x0, y0, x1, y1), exact but for Gaussian noise."""
    bearing = ANGLES + pose[2]
    ray = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    ranges = np.full(len(ANGLES), np.inf)
    for x0, y0, x1, y1 in walls:
        start, along = np.array([x0, y0]) - pose[:2], np.array([x1 - x0, y1 - y0])
        with np.errstate(divide='ignore', invalid='ignore'):
            cross = ray[:, 0] * along[1] - ray[:, 1] * along[0]
            r = (start[0] * along[1] - start[1] * along[0]) / cross
            u = (start[0] * ray[:, 1] - start[1] * ray[:, 0]) / cross
        hit = (r > 0.0) & (u >= 0.0) & (u <= 1.0)
        ranges = np.where(hit & (r < ranges), r, ranges)
    return ranges + (noise * rng.standard_normal(len(ranges)) if noise else 0.0)


# A wall 8 m to the left of a drive along x, and columns of half a metre in front of it.
WALL = [(-60.0, 8.0, 60.0, 8.0)]
COLUMNS = [s for x in np.arange(-48.0, 48.0, 6.0) for s in (
    (x, 6.0, x + 0.5, 6.0), (x, 6.0, x, 6.5), (x + 0.5, 6.0, x + 0.5, 6.5))]
LEFT = np.array([0.0, 0.0, np.pi / 2])       # mount: the scanner looks left


def scan_at(t, base, walls, **noise):
    pose = geometry.compose(base, LEFT)
    ranges = look(pose, walls, **noise)
    return Scan(round(1e9 * t), ranges, ANGLES, np.zeros(len(ANGLES)), range_max=80.0)


def prepared(ranges, brightness=None, start=0.2):
    """Rays of a scan at a time, as the estimator prepares them, all on surface 0."""
    rays = np.empty((len(ranges), RAY))
    bright = np.full(len(ranges), np.nan) if brightness is None else brightness
    labels = np.zeros(len(ranges), np.int32)
    n = prepare_rays(
        ranges, ANGLES, np.zeros(len(ranges)), labels, bright, start, 80.0, rays)
    return rays[:n]


def build(rays, knots=np.zeros((8, 3)), stride=2):
    """Surfels, their number and bins, and the edges of a keyframe at 0.2 s."""
    surfels, edges = np.empty((2048, surfel.SURFEL)), np.empty((EDGES, surfel.SURFEL))
    bins, edge_bins = np.empty((2, keyframe.BINS + 1), np.int32)
    count, found = keyframe.build(rays, knots, H, 0.2, ANGLES[1] - ANGLES[0], stride, surfels,
                                  bins, edges, edge_bins, np.empty(keyframe.SIGHTS))
    return surfels, count, bins, edges[:found]


def surfels_of(pose, walls, rng):
    """Surfels of a keyframe merged from 15 noisy scans taken at one pose (scanner frame)."""
    scans = [prepared(look(pose, walls, 0.01, rng)) for _ in range(15)]
    return build(np.concatenate(scans))[:3]


def test_a_wall_at_grazing_incidence_is_one_surface_and_a_column_another():
    labels = Segmenter().segment(scan_at(0.0, np.zeros(3), WALL + [(-0.5, 6.0, 0.5, 6.0)]))
    seen = [int(v) for v in dict.fromkeys(labels.tolist()) if v != UNLABELLED]
    # the wall before the column, the column, the wall behind it
    assert len(seen) == 3
    column = labels == labels[90]
    assert 7 <= column.sum() <= 11              # 1 m at 6 m is 9.5 rays


def test_surfaces_keep_their_number_while_they_pass():
    segmenter = Segmenter()
    segmenter.segment(scan_at(0.0, np.zeros(3), WALL + [(2.0, 6.0, 3.0, 6.0)]))
    first = None
    for k in range(60):
        labels = segmenter.segment(
            scan_at(0.0, np.array([0.07 * k, 0.0, 0.0]), WALL + [(2.0, 6.0, 3.0, 6.0)]))
        bearing = np.arctan2(2.5 - 0.07 * k, 6.0)
        label = labels[90 - round(np.rad2deg(bearing))]
        first = label if first is None else first
        assert label == first


def test_the_spline_reproduces_constant_motion_and_its_derivative():
    knots = np.arange(12)[:, None] * H * np.array([5.0, -1.0, 0.3])
    pose, rate = np.empty(3), np.empty(3)
    for t in (0.0, 0.234, 0.75):
        pose_at(knots, H, t, np.empty(4), pose)
        velocity_at(knots, H, t, rate)
        # coefficient k belongs to time (k - 1) h
        np.testing.assert_allclose(pose, (t + H) * np.array([5.0, -1.0, 0.3]), atol=1e-12)
        np.testing.assert_allclose(rate, [5.0, -1.0, 0.3], atol=1e-9)


def test_velocity_is_the_derivative_of_the_pose():
    knots = np.random.default_rng(5).normal(size=(12, 3))
    before, after, rate = np.empty(3), np.empty(3), np.empty(3)
    for t in (0.11, 0.37, 0.655):
        pose_at(knots, H, t - 1e-6, np.empty(4), before)
        pose_at(knots, H, t + 1e-6, np.empty(4), after)
        velocity_at(knots, H, t, rate)
        np.testing.assert_allclose(rate, (after - before) / 2e-6, atol=1e-6)


def test_surfels_lie_on_the_wall_with_its_normal():
    surfels, count, _ = surfels_of(LEFT, WALL, np.random.default_rng(2))
    found = surfels[:count]
    assert count > 300
    # the scanner's x axis points at the wall: it is at x = 8 there, its normal points back.
    # 0.8 m of a wall 8 m away hold at least 50 points of 1 cm: 1.4 mm, five of that and the
    # quantiles of 300 surfels
    near = np.abs(found[:, surfel.Y]) < 5.0
    assert np.abs(found[near, surfel.X] - 8.0).max() < 0.012
    assert np.all(found[near, surfel.NX] < -0.99)
    assert np.all(np.diff(found[:, surfel.S_BEARING]) >= 0.0)


def test_a_face_that_one_ray_meets_is_taken_to_face_the_scanner():
    # a post a hand wide, 9 m ahead, in a corridor that ends 5 m behind it
    ranges = look(np.zeros(3), [(0.0, 2.0, 14.0, 2.0), (0.0, -2.0, 14.0, -2.0),
                                (14.0, -2.0, 14.0, 2.0), (9.0, 0.1, 9.0, 0.25)])
    surfels, count, _, _ = build(prepared(ranges), stride=1)
    post = surfels[:count][np.abs(surfels[:count, surfel.X] - 9.0) < 0.01]
    post = post[np.abs(post[:, surfel.Y]) < 1.0]
    assert len(post) == 1
    np.testing.assert_allclose(post[0, :2], 9.0 * np.array([1.0, np.tan(ANGLES[91])]), atol=1e-9)
    # which way it faces is not known
    assert post[0, surfel.NX] < -0.99 and post[0, surfel.NORMAL_VAR] > 0.05


@pytest.mark.parametrize('shift', [(0.02, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, 0.002)])
def test_one_linearisation_finds_a_small_relative_pose(shift):
    rng = np.random.default_rng(3)
    shift = np.array(shift)
    a, count_a, _ = surfels_of(geometry.compose(LEFT, shift), WALL + COLUMNS, rng)
    b, count_b, bins = surfels_of(LEFT, WALL + COLUMNS, rng)
    hessian, gradient, votes = np.empty((3, 3)), np.empty(3), np.zeros(LABELS + 1)
    z = np.zeros(3)
    for _ in range(4):
        pairs.linearise(a, count_a, b, count_b, bins, z, 0.1, 0, 1, 0.0, np.ones(LABELS),
                        np.array([0.0, -1.0]), hessian, gradient, votes)
        z -= np.linalg.solve(hessian, gradient)
    # hundreds of residuals of a few millimetres towards the wall; along it only the columns'
    # sides tell, half a dozen faces with a few rays of 1 cm each: three standard deviations
    assert z[0] == pytest.approx(shift[0], abs=0.004)
    assert z[1] == pytest.approx(shift[1], abs=0.020)
    assert z[2] == pytest.approx(shift[2], abs=0.0006)
    assert votes[0] > 20.0 and votes[-1] == 4.0


def test_a_bare_wall_tells_nothing_along_itself():
    rng = np.random.default_rng(4)
    a, count_a, _ = surfels_of(LEFT, WALL, rng)
    b, count_b, bins = surfels_of(LEFT, WALL, rng)
    hessian, gradient = np.empty((3, 3)), np.empty(3)
    pairs.linearise(a, count_a, b, count_b, bins, np.zeros(3), 0.1, 0, 1, 0.0, np.ones(LABELS),
                    np.zeros(2), hessian, gradient, np.zeros(LABELS + 1))
    across, along = hessian[0, 0], hessian[1, 1]
    assert along < 1e-3 * across


@pytest.mark.parametrize('shift', [0.0, 0.03, -0.05])
def test_a_surface_that_shifts_is_told_from_those_that_stand(shift):
    rng = np.random.default_rng(5)
    begins = np.array([-11.0, -5.0, 4.0, 10.0])

    def seen(begins):
        cars = [c for x in begins for c in (
            (x, 5.0, x + 1.5, 5.0), (x, 5.0, x, 6.5), (x + 1.5, 5.0, x + 1.5, 6.5))]
        return surfels_of(LEFT, WALL + cars, rng)

    a, count_a, _ = seen(begins + [0.0, 0.0, shift, 0.0])
    b, count_b, bins = seen(begins)
    # the scanner's y axis points backwards; the wall belongs to no surface
    ahead = -a[:count_a, surfel.Y]
    number = np.abs(begins[:, None] + 0.75 - ahead).argmin(axis=0)
    a[:count_a, surfel.S_LABEL] = np.where(a[:count_a, surfel.X] < 7.5, number, -1.0)
    testimony = np.zeros((2, LABELS))
    pairs.testify(a, count_a, b, count_b, bins, np.zeros(3), 0.06, 1, 0.0,
                  np.array([0.0, -1.0]), testimony)
    assert testimony[0, -1] == 0.0
    # a dozen rays and more of 1 cm on the side that faces the scanner: three times 3 mm
    assert np.all(testimony[0, :4] > 3.0)
    apart = testimony[1, :4] / testimony[0, :4]
    np.testing.assert_allclose(apart, [0.0, 0.0, -shift, 0.0], atol=0.009)


@pytest.mark.parametrize(('speed', 'turn'), [(8.0, 0.0), (-3.0, 0.0), (0.0, 0.0), (5.0, 0.35)])
def test_the_range_image_tells_speed_and_turn_rate(speed, turn):
    rng = np.random.default_rng(6)
    search = SlopeSearch(LEFT)
    for k in range(46):
        t = 0.01332 * k
        base = geometry.exp(t * np.array([speed, 0.0, turn]))
        scan = scan_at(t, base, WALL + COLUMNS, noise=0.01, rng=rng)
        search.add((t, ANGLES, scan.ranges))
    twist, cost = search.best()
    assert twist[0] == pytest.approx(speed, abs=0.25)
    assert twist[2] == pytest.approx(turn, abs=0.06)
    assert cost < 0.7 * search.cost_of(twist + [2.0, 0.0, 0.0])


@pytest.mark.parametrize('speed', [4.0, -1.0])
def test_a_candidate_that_accelerates_tells_the_speed_at_the_end(speed):
    rng, rate, end = np.random.default_rng(8), 3.0, 0.01332 * 45
    steady, gaining = (SlopeSearch(LEFT, acceleration=a, until=end) for a in (0.0, rate))
    for k in range(46):
        t = 0.01332 * k
        moved = speed * (t - end) + 0.5 * rate * (t - end) ** 2
        scan = scan_at(t, np.array([moved, 0.0, 0.0]), WALL + COLUMNS, noise=0.01, rng=rng)
        for search in (steady, gaining):
            search.add((t, ANGLES, scan.ranges))
    twist, cost = gaining.best()
    assert twist[0] == pytest.approx(speed, abs=0.1)
    mean, worse = steady.best()
    assert mean[0] < speed - 0.3 and cost < worse
    assert gaining.coarse_cost() < steady.coarse_cost()


@pytest.mark.parametrize('rate', [2.5, -2.5])
def test_another_motion_is_found_while_speed_is_gained_or_lost(rate):
    rng, end = np.random.default_rng(9), 0.01332 * 45
    speed = 4.0 + rate * end
    profiles = []
    for k in range(46):
        t = 0.01332 * k
        moved = speed * (t - end) + 0.5 * rate * (t - end) ** 2
        scan = scan_at(t, np.array([moved, 0.0, 0.0]), WALL + COLUMNS, noise=0.01, rng=rng)
        profiles.append((t, ANGLES, scan.ranges))
    # the path stayed behind, and has hardly changed its speed
    path = np.array([4.0, 0.0, 0.0])
    found = Recovery(LEFT).another_motion(profiles, path, 0.1 * rate, 0.5, True)
    assert found is not None
    twist, acceleration = found
    # rays 0.1 m apart at 6 m, scans 0.45 s apart
    assert twist[0] == pytest.approx(speed, abs=0.1 / 0.45) and acceleration == rate
    # a path that is right is left alone
    true = np.array([speed, 0.0, 0.0])
    assert Recovery(LEFT).another_motion(profiles, true, rate, 0.5, True) is None


def drive_past_leaves(begin: float, speed: float, share: float) -> list[Profile]:
    """Return profiles of 0.6 s at a speed, a share of whose rays end anywhere."""
    rng = np.random.default_rng(int(10.0 * begin))
    profiles = []
    for k in range(46):
        t = begin + 0.01332 * k
        scan = scan_at(t, np.array([speed * t, 0.0, 0.0]), WALL + COLUMNS, noise=0.01, rng=rng)
        leaves = rng.random(181) < share
        profiles.append((t, ANGLES, np.where(leaves, rng.uniform(2.0, 9.0, 181), scan.ranges)))
    return profiles


def test_a_motion_that_is_merely_better_is_believed_when_three_looks_find_it():
    path, recovery = np.array([-1.0, 0.0, 0.0]), Recovery(LEFT)
    looks = [drive_past_leaves(begin, 5.0, 0.15) for begin in (0.0, 0.3, 0.6)]
    found = [recovery.another_motion(each, path, 0.0, 0.3, True) for each in looks]
    assert found[0] is None and found[1] is None
    assert found[2] is not None
    assert found[2][0][0] == pytest.approx(5.0, abs=0.1 / 0.45)
    # too long ago to be of the same motion
    late = Recovery(LEFT)
    apart = [drive_past_leaves(begin, 5.0, 0.15) for begin in (0.0, 1.0, 2.0)]
    assert all(late.another_motion(each, path, 0.0, 0.3, True) is None for each in apart)


def test_a_motion_the_other_way_is_believed_when_three_looks_find_it():
    looks = [drive_past_leaves(begin, 4.0, 0.0) for begin in (0.0, 0.3, 0.6)]
    believed = {}
    for speed in (0.5, -0.5, -3.0):
        recovery, path = Recovery(LEFT), np.array([speed, 0.0, 0.0])
        believed[speed] = [recovery.another_motion(each, path, 0.0, 0.3, True) is not None
                           for each in looks]
    # as one that has begun to move it is believed at once
    assert believed == {0.5: [True] * 3, -0.5: [True] * 3, -3.0: [False, False, True]}


def test_looks_that_find_different_motions_are_not_believed():
    path, recovery = np.array([-1.0, 0.0, 0.0]), Recovery(LEFT)
    for begin, speed in ((0.0, 5.0), (0.3, 2.0), (0.6, 7.0)):
        look = drive_past_leaves(begin, speed, 0.15)
        assert recovery.another_motion(look, path, 0.0, 0.3, True) is None


def test_a_motion_that_was_lost_is_looked_for_until_it_is_found_where_the_path_has_it():
    path, recovery = np.array([-1.0, 0.0, 0.0]), Recovery(LEFT)
    assert recovery.confirmed
    blind = [(t, angles, np.full_like(ranges, np.nan))
             for t, angles, ranges in drive_past_leaves(0.0, 5.0, 0.0)]
    assert recovery.another_motion(blind, path, 0.0, 2.0, False) is None
    assert not recovery.confirmed
    # what has come into view agrees with the path, which seems sure of itself again
    for begin in (0.3, 0.6, 0.9):       # the other way is believed when three looks have found it
        found = recovery.another_motion(
            drive_past_leaves(begin, 5.0, 0.0), path, 0.0, 0.2, False)
        assert not recovery.confirmed
    assert found is not None and found[0][0] == pytest.approx(5.0, abs=0.1 / 0.45)
    assert recovery.another_motion(
        drive_past_leaves(1.2, 5.0, 0.0), found[0], 0.0, 0.2, False) is None
    assert recovery.confirmed


def test_without_anything_to_see_the_proposal_is_to_stand():
    search = SlopeSearch(LEFT)
    for k in range(50):
        search.add((0.01 * k, ANGLES, np.full(181, np.nan)))
    twist, _ = search.best()
    np.testing.assert_allclose(twist, 0.0, atol=1e-9)


@pytest.mark.parametrize(('new', 'votes', 'alone'), [
    (0, [300.0], 1.0), (0, [200.0, 200.0], 0.5),
    # one witness is worth WITNESS votes at most, so that a few others are company
    (0, [1e4, 25.0, 25.0, 25.0, 25.0], 1.0 / 1.8),
    # and who has just come into view says little yet
    (1, [200.0, 200.0], 1.0 / (1.0 + NEW))])
def test_a_surface_that_tells_all_of_the_motion_is_noticed(new, votes, alone):
    trust = Trust()
    trust.add(new)
    trust.votes[:len(votes)], trust.votes[-1] = votes, USUAL_ROUNDS
    trust.update(np.zeros(20), True, False)
    assert trust.alone == pytest.approx(alone, abs=0.01)


def test_a_surface_earns_trust_and_loses_it_as_a_whole():
    trust, rays = Trust(), np.zeros(20)

    def judge(agree, through, certain):
        trust.reset()
        trust.votes[0], trust.votes[-1], trust.through[0] = agree, 24.0, through
        trust.update(rays, certain, certain)

    trust.add(1)
    assert trust.weight[0] == NEW
    for _ in range(8):
        judge(9.0, 1.0, True)
    assert trust.weight[0] > 0.95 and trust.agreement > 0.9
    # nobody is condemned by a motion that is not known itself
    for certain, condemned in ((False, False), (True, True)):
        for _ in range(8):
            judge(0.5, 10.0, certain)
        assert bool(trust.weight[0] < MOVES) == condemned
    # nor cleared by one
    for _ in range(8):
        judge(9.0, 0.0, False)
    assert trust.weight[0] < MOVES
    trust.add(2)
    trust.pardon()
    assert trust.weight[0] < MOVES and trust.weight[1] == 1.0


@given(st.lists(st.integers(1, 10_000), min_size=2, max_size=2, unique=True))
def test_a_surface_is_one_witness_however_many_rays_it_has(said):
    said.sort()
    trust, rays = Trust(), np.repeat([0.0, 1.0], 20)
    trust.votes[:2], trust.votes[-1] = said, 24.0
    trust.update(rays, True, True)
    weight = trust.of_residuals()[:2]
    spoken = weight * said
    assert weight[0] > weight[1] > 0.0                  # the louder, the less each ray counts
    assert spoken[0] < spoken[1] < WITNESS              # yet it is not counted for less
    trust.weight[0] = 0.9 * MOVES
    assert trust.of_residuals()[0] == 0.0


def test_a_surface_that_is_apart_from_the_others_counts_for_less():
    trust, rays = Trust(), np.repeat([0.0, 1.0], 20)

    def hear(apart, clear, times):
        for _ in range(times):
            trust.reset()
            trust.votes[:2], trust.votes[-1] = 50.0, 24.0
            trust.testimony[:, 0] = 10.0, 10.0 * apart
            trust.testimony[:, 1] = 10.0, 0.0
            trust.update(rays, True, clear)
        return float(trust.of_residuals()[0] / trust.of_residuals()[1])

    assert hear(0.9 * STEADY, True, 20) == 1.0
    assert hear(5.0 * STEADY, False, 20) == 1.0         # it may be the only one that is right
    few, many = hear(-5.0 * STEADY, True, 1), hear(5.0 * STEADY, True, 40)
    assert many < few < 1.0
    assert many == pytest.approx((1.0 + 50.0 / WITNESS) / (1.0 + WAYWARD * 50.0 / WITNESS))
    # it is believed again, but not at once
    assert hear(0.0, True, 10) < 0.6
    assert hear(0.0, True, 400) == 1.0
    hear(5.0 * STEADY, True, 40)
    trust.add(1)
    assert trust.of_residuals()[0] < trust.of_residuals()[1]         # new, and else like any
    trust.weight[0] = 1.0
    assert trust.of_residuals()[0] == 1.0


def test_known_surfaces_that_fall_silent_raise_doubt():
    trust, rays = Trust(), np.zeros(20)
    trust.add(1)
    for agree in [9.0] * 8 + [0.0] * 2:
        trust.reset()
        trust.votes[0], trust.votes[-1] = agree, 24.0
        trust.update(rays, True, True)
    assert trust.agreement < 0.2
    trust.pardon()
    assert trust.agreement == 1.0


def test_what_came_to_a_place_seen_through_counts_and_what_hides_does_not():
    wall = np.column_stack([np.linspace(-10.0, 10.0, 400), np.full(400, 8.0)])
    sight, votes = np.empty(keyframe.SIGHTS), np.zeros(4)
    keyframe.look(wall, np.arctan2(wall[:, 1], wall[:, 0]), sight)
    knots, home = np.zeros((8, 3)), np.zeros(3)
    # nearer than the wall seen before; on it; hidden behind it; where nothing was seen at all
    for label, (r, bearing) in enumerate([(4.0, 90.0), (8.0, 90.0), (12.0, 90.0), (4.0, -90.0)]):
        ray = np.array([[r, np.deg2rad(bearing), 0.2, 0.0, label]])
        count_through(ray, 1, knots, H, home, sight, votes)
    np.testing.assert_array_equal(votes, [1.0, 0.0, 0.0, 0.0])
    # a surface of before that the newer keyframe, a metre on, sees through has left
    surfels = np.zeros((3, surfel.SURFEL))
    surfels[:, surfel.X], surfels[:, surfel.Y] = 0.0, [4.0, 8.0, 12.0]
    surfels[:, surfel.S_LABEL] = [0, 1, 2]
    votes[:] = 0.0
    count_left(surfels, 3, 1, np.array([-1.0, 0.0, 0.0]), sight, votes)
    np.testing.assert_array_equal(votes, [1.0, 0.0, 0.0, 0.0])


def test_surfaces_that_touch_for_a_moment_keep_their_numbers():
    segmenter = Segmenter()
    seen = []
    for gap in (3.0, 1.0, 0.0, 1.0, 3.0):
        walls = [(-6.0, 5.0, -0.5 * gap, 5.0), (0.5 * gap, 5.0, 6.0, 5.0)]
        scan = scan_at(0.0, np.zeros(3), walls)
        labels = segmenter.segment(scan)
        seen.append((int(labels[50]), int(labels[130])))
    assert seen[0][0] != seen[0][1]
    assert all(pair == seen[0] for pair in seen)


def test_the_range_image_slides_and_the_log_thins(tmp_path):
    window, log = RangeImage(1.0), RangeImageLog(capacity=100)
    for k in range(1000):
        scan = scan_at(0.01332 * k, np.zeros(3), WALL)
        labels = np.zeros(181, np.int32)
        window.append(scan, labels)
        log.append(scan, labels)
    assert len(window) == 76                    # one second at 13.32 ms, both ends
    assert window.picture().shape == (76, 181)
    assert window.segment_picture().shape == (76, 181, 3)
    log.save(tmp_path / 'image.npz')
    with np.load(tmp_path / 'image.npz') as image:
        assert 50 <= len(image['stamps_ns']) <= 100
        assert image['ranges'].shape == image['segments'].shape == (len(image['stamps_ns']), 181)
        assert image['stamps_ns'][-1] > 0.9 * 999 * 13_320_000


def test_base_link_and_its_covariance_follow_from_the_spline_of_the_scanner():
    rng = np.random.default_rng(11)
    knots = np.cumsum(rng.normal([0.8, 0.0, 0.05], [0.05, 0.05, 0.02], (12, 3)), axis=0)
    mount, origin, h, t = np.array([0.4, -1.1, 1.2]), np.array([3.0, -2.0, 0.7]), 0.1, 0.537
    root = rng.normal(0.0, 0.01, (36, 36))
    covariance = root @ root.T

    def base(knots):
        out = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
        of_base(knots, h, t, covariance, 0, mount, origin, *out)
        return out

    pose, pose_covariance, twist, twist_covariance = base(knots)
    sensor, step = np.empty(3), np.empty(3)
    pose_at(knots, h, t, np.empty(4), sensor)
    np.testing.assert_allclose(
        pose, geometry.compose(origin, geometry.compose(sensor, geometry.inverse(mount))))
    # the twist is the way to the pose a moment later
    pose_at(knots, h, t + 1e-6, np.empty(4), step)
    later = geometry.compose(origin, geometry.compose(step, geometry.inverse(mount)))
    np.testing.assert_allclose(
        twist, 1e6 * geometry.compose(geometry.inverse(pose), later), atol=1e-4)
    # covariances are those of small changes of the knots, by differences
    J_pose, J_twist = np.empty((3, 36)), np.empty((3, 36))
    for i in range(36):
        change = np.zeros(36)
        change[i] = 1e-6
        moved = base(knots + change.reshape(12, 3))
        J_pose[:, i], J_twist[:, i] = (moved[0] - pose) / 1e-6, (moved[2] - twist) / 1e-6
    np.testing.assert_allclose(pose_covariance, J_pose @ covariance @ J_pose.T, rtol=1e-3)
    np.testing.assert_allclose(
        twist_covariance, J_twist @ covariance @ J_twist.T, rtol=1e-3, atol=1e-6)
    assert speed_sigma(twist_covariance) == pytest.approx(
        np.sqrt(np.linalg.eigvalsh(twist_covariance[:2, :2])[-1]))


@given(st.integers(0, 10_000))
@settings(max_examples=50)
def test_no_pair_knows_less_than_nothing(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-3.0, 3.0, 3)
    hessian, gradient = root.T @ root, rng.normal(size=3)
    hessian[:2, :2] -= rng.uniform(0.0, 1.2) * np.linalg.eigvalsh(hessian[:2, :2])[0] * np.eye(2)
    pairs._clamp(hessian, gradient)
    full = np.triu(hessian) + np.triu(hessian, 1).T
    size = np.abs(full).max()
    assert np.linalg.eigvalsh(full)[0] > -1e-9 * size


def test_a_ray_of_no_length_is_no_surface():
    ranges = np.full(181, 5.0)
    ranges[[0, 90, 91]] = 0.0
    labels = Segmenter().segment(Scan(0, ranges, ANGLES, np.zeros(181)))
    assert (labels[[0, 90, 91]] == -1).all() and (labels[1:90] >= 0).all()
