# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
from scipy.stats import norm

from stri_mapping import geometry
from stri_mapping.errors import UsageError
from stri_mapping.scan import MIRROR_TURN, ray_times
from stri_mapping.simulation.lms import LmsModel, variant, VARIANTS
from stri_mapping.simulation.mesh import MeshBuilder, Surface
from stri_mapping.simulation.motion import KNOT, Motion
from stri_mapping.simulation.ray_cast import RayCaster
from stri_mapping.simulation.scanner import CLOCK, VirtualScanner
from stri_mapping.simulation.scene import Scene
from stri_mapping.simulation.traffic import Mover
from stri_mapping.vehicle import Scanner

WHITE = Surface('white', 0.8)
LEVEL = Scanner('horizontal', 'horizontal', np.eye(4), 'laser', 'horizontal/scan')
# Rounding to steps of 10 mm adds the variance of a uniform error to the noise of 10 mm.
SENT_SIGMA = np.hypot(0.010, 0.010 / np.sqrt(12.0))


def wall_ahead(distance, surface=WHITE, half=40.0):
    """Return a wall square to the x axis."""
    builder = MeshBuilder()
    builder.quads([[(distance, -half, -half), (distance, half, -half), (distance, half, half),
                    (distance, -half, half)]], surface)
    return builder.mesh()


def moving(velocity, duration=4.0):
    """Return a motion with constant rates (6,)."""
    t = np.arange(int(duration / KNOT) + 20) * KNOT
    return Motion(t[:, None] * np.asarray(velocity, float))


def scene(mesh, velocity=(0.0,) * 6, duration=4.0, **more):
    return Scene('test', mesh, moving(velocity, duration), duration, **more)


def pencil(**more):
    return LmsModel(divergence=1e-9, spot=1e-9, dropout=0.0, **more)


def test_wall_seen_on_the_move_is_flat_to_the_noise_with_ray_times_and_bent_without():
    # 15 m/s towards the wall, turning at 20 deg/s
    scanner = VirtualScanner(LEVEL, pencil(), scene(
        wall_ahead(35.0), (15.0, 0.0, 0.0, 0.0, 0.0, np.deg2rad(20.0)), 2.0), 1, 0)
    residual, frozen, sigma = [], [], []
    for timed in scanner.stream(2.0):
        scan = timed.scan
        near = scan.valid & (np.abs(scan.angles) < 1.0)
        t = scan.stamp_ns * 1e-9 + scan.times
        for times, out in ((t, residual), (np.full_like(t, t[0]), frozen)):
            pose = scanner.scene.motion.at(times)[:, [0, 1, 5]]
            point = geometry.compose(pose, np.column_stack([scan.points, np.zeros(len(scan))]))
            out.append((point[:, 0] - 35.0)[near])
        heading = scanner.scene.motion.at(t)[:, 5] + scan.angles
        grows = np.maximum(1.0, scan.ranges / 20.0)
        sigma.append((np.hypot(0.010 * grows, 0.010 / np.sqrt(12)) * np.cos(heading))[near])
    ratio = np.concatenate(residual) / np.concatenate(sigma)
    assert len(ratio) > 5000
    # standard errors of mean and deviation of n normal numbers, four of each
    assert abs(ratio.mean()) < 4.0 / np.sqrt(len(ratio))
    assert abs(ratio.std() - 1.0) < 4.0 / np.sqrt(2 * len(ratio)) + 0.005
    # 15 m/s for up to 6.7 ms is 10 cm
    rms, rms_frozen = (np.sqrt(np.mean(np.concatenate(r) ** 2)) for r in (residual, frozen))
    assert rms < 0.015 and rms_frozen > 3.0 * rms


def test_ranges_of_a_wall_have_the_histogram_of_noise_and_quantisation():
    scanner = VirtualScanner(LEVEL, pencil(), scene(wall_ahead(7.0043), duration=20.0), 5, 0)
    ahead = np.array([t.scan.ranges[90] for t in scanner.stream(20.0)])
    steps, counts = np.unique(np.round(ahead / 0.01).astype(int), return_counts=True)
    assert np.allclose(ahead, steps[np.searchsorted(steps, np.round(ahead / 0.01))] * 0.01,
                       atol=1e-6)
    edges = (np.arange(steps[0], steps[-1] + 2) - 0.5) * 0.01
    expected = len(ahead) * np.diff(norm.cdf(edges, 7.0043, 0.010))
    observed = np.zeros(len(expected))
    observed[steps - steps[0]] = counts
    likely = expected > 5.0
    chi2 = ((observed - expected)[likely] ** 2 / expected[likely]).sum()
    # a chi-square of k degrees has mean k and variance 2 k
    assert chi2 < likely.sum() + 4.0 * np.sqrt(2.0 * likely.sum())


def test_each_surface_has_its_own_bias():
    near = []
    for bias in (0.0, 0.012):
        mesh = wall_ahead(7.0, Surface('white', 0.8, bias))
        scanner = VirtualScanner(LEVEL, pencil(), scene(mesh), 5, 0)
        near.append(np.mean([t.scan.ranges[85:96] for t in scanner.stream(4.0)]))
    # the same noise in both, so that only the rounding differs: 10 mm / sqrt(12 n), n = 3300
    assert near[1] - near[0] == pytest.approx(0.012, abs=4 * 0.010 / np.sqrt(12 * 3300))


def test_dark_surfaces_are_seen_less_far():
    # a 10 % target is just seen at 30 m, so one of 2.5 % at half of that
    for distance, seen in ((13.0, True), (17.5, False)):
        mesh = wall_ahead(distance, Surface('black', 0.025))
        scanner = VirtualScanner(LEVEL, pencil(), scene(mesh), 1, 0)
        share = np.isfinite([t.scan.ranges[90] for t in scanner.stream(2.0)]).mean()
        assert share > 0.99 if seen else share < 0.1
    reads = VirtualScanner(LEVEL, pencil(), scene(wall_ahead(90.0, half=200.0)), 1, 0)
    assert np.isinf(reads.turns(0, 1)[0].scan.ranges[90])        # beyond range_max


def test_rays_drop_out_as_often_as_the_model_says():
    model = dataclasses.replace(pencil(), dropout=0.02)
    scanner = VirtualScanner(LEVEL, model, scene(wall_ahead(5.0)), 1, 0)
    lost = np.isinf([t.scan.ranges[60:121] for t in scanner.stream(4.0)])
    assert lost.mean() == pytest.approx(0.02, abs=4 * np.sqrt(0.02 / lost.size))


def test_sun_dazzles_rays_that_meet_nothing():
    sun = np.array([np.cos(1.0), np.sin(1.0), 0.0])
    ranges = VirtualScanner(LEVEL, pencil(), scene(wall_ahead(5.0, half=4.0), sun=sun), 1,
                            0).turns(0, 1)[0].scan.ranges
    blind = np.flatnonzero(np.isnan(ranges)) - 90
    assert 4 <= len(blind) <= 5 and abs(blind.mean() - np.rad2deg(1.0)) < 0.6
    behind = VirtualScanner(LEVEL, pencil(), scene(wall_ahead(5.0), sun=sun), 1, 0)
    assert not np.isnan(behind.turns(0, 1)[0].scan.ranges).any()


@pytest.mark.parametrize('name', VARIANTS)
def test_turns_alternate_their_raster_and_keep_the_mirrors_time(name):
    model = variant(name)
    scanner = VirtualScanner(LEVEL, model, scene(wall_ahead(5.0)), 3, 0)
    timed = scanner.turns(0, 9)
    for k, t in enumerate(timed):
        raster = k % model.rasters
        first = -0.5 * model.field + raster * model.resolution
        scan = t.scan
        assert len(scan) == int(model.field) + (1 if raster == 0 else 0)
        assert np.allclose(np.rad2deg(scan.angles), first + np.arange(len(scan)), atol=1e-4)
        # t0 + T (q + a / 360), a from the scanner's right
        begin = scanner.phase + scanner.period * (k + (first + 90.0) / 360.0)
        assert abs(scan.stamp_ns - 1e9 * begin) <= 0.5
        assert np.allclose(scan.times, MIRROR_TURN / 360.0 * np.arange(len(scan)), atol=1e-8)
        assert t.arrival_ns > scan.end_ns
        late = t.arrival_ns * 1e-9 - (scanner.phase + scanner.period * (k + 1))
        assert model.transfer(len(scan)) <= late <= model.transfer(len(scan)) + 0.001
    stamps = np.array([t.scan.stamp_ns for t in timed])
    assert np.all(np.diff(stamps) > 0)


def test_two_half_degree_turns_make_the_merged_scan_that_the_reader_knows():
    scanner = VirtualScanner(LEVEL, variant('180x0.5'), scene(wall_ahead(5.0)), 3, 0)
    whole, half = (t.scan for t in scanner.turns(0, 2))
    times = np.empty(361)
    times[::2] = whole.times
    times[1::2] = half.times + 1e-9 * (half.stamp_ns - whole.stamp_ns)
    expected, turns = ray_times(361, np.deg2rad(0.5), 0.0)
    # the clock is up to 50 ppm off, over two turns
    assert turns == 2 and np.allclose(times, expected, atol=2 * MIRROR_TURN * CLOCK)


def test_interlaced_turns_see_a_comb_when_the_vehicle_moves():
    scanner = VirtualScanner(LEVEL, pencil(resolution=0.5, noise=0.0, quantisation=1e-4),
                             scene(wall_ahead(20.0), (10.0, 0, 0, 0, 0, 0)), 3, 0)
    whole, half = (t.scan for t in scanner.turns(0, 2))
    ahead, aside = whole.ranges[90], half.ranges[90]          # bearings 0 and 0.5 degrees
    # one turn and half a degree later, at 10 m/s
    assert ahead - aside == pytest.approx(10.0 * MIRROR_TURN * (1 + 0.5 / 360), abs=2e-3)


def test_turn_by_turn_gives_what_many_at_once_give():
    scanner = VirtualScanner(LEVEL, variant('100x0.25'), scene(
        wall_ahead(15.0), (3.0, 0, 0, 0, 0, 0.1)), 4, 2, remission=True)
    for k, together in enumerate(scanner.turns(0, 10)):
        alone = scanner.turns(k, k + 1)[0]
        assert alone.arrival_ns == together.arrival_ns
        assert np.array_equal(alone.scan.ranges, together.scan.ranges)
        assert np.array_equal(alone.scan.intensities, together.scan.intensities)


def test_scanners_run_freely_and_seeds_differ():
    street = scene(wall_ahead(15.0))
    scanners = [VirtualScanner(LEVEL, LmsModel(), street, seed, index)
                for seed in (1, 2) for index in (0, 1)]
    assert len({s.phase for s in scanners}) == 4 and len({s.period for s in scanners}) == 4
    assert all(abs(s.period / MIRROR_TURN - 1.0) <= CLOCK for s in scanners)
    assert all(0.0 <= s.phase < s.period for s in scanners)
    ranges = [s.turns(0, 1)[0].scan.ranges.tobytes() for s in scanners]
    assert len(set(ranges)) == 4
    assert VirtualScanner(LEVEL, LmsModel(), street, 1, 0).turns(0, 1)[0].scan.ranges.tobytes() \
        == ranges[0]


def test_intensities_are_per_cent_of_white():
    scanner = VirtualScanner(LEVEL, pencil(), scene(wall_ahead(8.0, Surface('grey', 0.5))), 1, 0,
                             remission=True)
    ahead = np.mean([t.scan.intensities[90] for t in scanner.stream(2.0)])
    assert ahead == pytest.approx(50.0, abs=1.0)


def test_moving_body_is_where_it_is_at_each_rays_time():
    box = MeshBuilder()
    box.box((-2.0, -1.0, -1.0), (2.0, 1.0, 1.0), WHITE)
    times = np.arange(0.0, 4.1, 0.1)
    speed, turned = 12.0, np.deg2rad(90.0)
    # it drives along +y, its side 1 m towards the scanner, 10 m ahead
    poses = np.column_stack([np.full_like(times, 10.0), speed * (times - 2.0),
                             np.full_like(times, turned)])
    mover = Mover('box', RayCaster(box.mesh()), times, poses)
    scanner = VirtualScanner(LEVEL, pencil(noise=0.0, quantisation=1e-4), scene(
        wall_ahead(50.0, half=200.0), movers=(mover,)), 1, 0)
    seen = 0
    for timed in scanner.turns(120, 180):
        scan = timed.scan
        x, y = scan.points.T
        along = y - speed * (1e-9 * scan.stamp_ns + scan.times - 2.0)
        on_it = x < 20.0
        seen += on_it.sum()
        # every ray that meets it meets its outline as it stands at that ray's own time
        assert np.all(np.abs(along[on_it]) < 2.0 + 1e-3)
        assert np.allclose(x[on_it & (np.abs(along) < 1.99)], 9.0, atol=1e-3)
    assert seen > 500


def test_distances_are_exact_far_from_the_origin():
    builder = MeshBuilder()
    far = np.array([50000.0, 80000.0])
    builder.quads([[(far[0] + 10, far[1] - 5, -5), (far[0] + 10, far[1] + 5, -5),
                    (far[0] + 10, far[1] + 5, 5), (far[0] + 10, far[1] - 5, 5)]], WHITE)
    caster = RayCaster(builder.mesh())
    angle = np.linspace(-0.3, 0.3, 31)
    directions = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(31)])
    distance, cosine, triangle = caster.cast(np.tile([*far, 0.0], (31, 1)), directions)
    # single precision alone would be off by 4 mm here
    assert np.allclose(distance, 10.0 / np.cos(angle), atol=1e-9)
    assert np.allclose(cosine, np.cos(angle)) and np.all(triangle >= 0)


def test_unknown_variant_is_refused_by_name():
    with pytest.raises(UsageError, match='"360x1".*180x0.5'):
        variant('360x1')
