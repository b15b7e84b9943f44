# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Points that hang between two surfaces are told from those on either, and from slopes."""

from __future__ import annotations

from collections.abc import Callable
import pickle

import numpy as np
from numpy.typing import NDArray
import pytest

from stri_mapping.facade.ghosts import GhostFinder
from stri_mapping.facade.points import FACADE, GROUND, NOISE, Rays
from stri_mapping.geometry import transform
from stri_mapping.vehicle import Scanner

Array = NDArray[np.float64]
TURN_NS = 13_320_000
# In laser coordinates x is the way out and y up: level, looking left, 1.9 m above the road.
SIDE = Scanner('side', 'vertical', transform((0.0, 0.0, 1.9), (0.5 * np.pi, 0.0, 0.5 * np.pi)),
               '', '')
ANGLES = np.deg2rad(np.arange(-10.0, 45.0))
Depth = Callable[[float, Array], Array]


def rays_of(numbers: Array, depth: Depth, step: float = 0.1, noise: float = 0.0,
            raster: Callable[[int], float] = lambda k: 0.0, seed: int = 0) -> Rays:
    """Return lines `step` metres apart of a facade, depth (n,) at a place and heights (n,)."""
    rng, base, poses = np.random.default_rng(seed), [], []
    for k in numbers.astype(int).tolist():
        angles = ANGLES + raster(k)
        out = depth(step * k, 1.9 + 9.0 * np.tan(angles))
        ranges = out / np.cos(angles) + rng.normal(0.0, noise, len(angles))
        base.append(np.column_stack([0.0 * out, ranges * np.cos(angles),
                                     1.9 + ranges * np.sin(angles)]))
        poses.append(np.tile([step * k, 0.0, 0.0], (len(angles), 1)))
    n = len(ANGLES) * len(numbers)
    stamps = np.repeat(numbers.astype(np.int64) * TURN_NS, len(ANGLES))
    return Rays(np.concatenate(base), np.concatenate(poses), stamps, np.zeros(n, np.float32),
                np.zeros(n, np.uint16), np.arange(len(numbers) + 1) * len(ANGLES))


def ghosts(rays: Rays) -> NDArray[np.bool_]:
    """Return which rays (lines, rays of a line) are marked."""
    label = np.full(len(rays), FACADE, np.uint8)
    GhostFinder([SIDE]).mark(rays, label)
    return (label == NOISE).reshape(-1, len(ANGLES))


def window(x: float, z: Array) -> Array:
    """Return a wall with a recess from x = 1 to 2; the line at each side of it hits both."""
    depth = np.full(len(z), 9.0)
    inside = (z > 2.5) & (z < 6.0)
    depth[inside & (1.02 < x < 1.98)] = 9.25
    depth[inside & (min(abs(x - 1.0), abs(x - 2.0)) < 0.02)] = 9.12
    return depth


@pytest.mark.parametrize('step', [0.1, 0.05])
@pytest.mark.parametrize('raster', [lambda k: 0.0, lambda k: np.deg2rad(0.5 * (k % 2))])
def test_a_line_that_hits_wall_and_pane_is_marked(step: float,
                                                  raster: Callable[[int], float]) -> None:
    rays = rays_of(np.arange(round(4.0 / step)), window, step, raster=raster)
    found = ghosts(rays)
    between = np.abs(rays.base[:, 1] - 9.12).reshape(found.shape) < 0.01
    assert between.sum() > 20
    assert not (found & ~between).any()
    # in its topmost and lowest row an interlaced line has nothing to compare with
    assert found.sum() >= 0.9 * between.sum()


def test_ghosts_are_the_same_however_lines_come() -> None:
    at_once = ghosts(rays_of(np.arange(40), window))
    finder, labels = GhostFinder([SIDE]), []
    for cut in np.array_split(np.arange(40), 9):
        labels.append(np.full(len(cut) * len(ANGLES), FACADE, np.uint8))
        finder.mark(rays_of(cut, window), labels[-1])
    np.testing.assert_array_equal(np.concatenate(labels) == NOISE, at_once.ravel())


def test_a_single_point_between_two_even_stretches_is_marked() -> None:
    def sill(x: float, z: Array) -> Array:
        depth = np.where(z > 5.0, 9.3, 9.0)
        depth[int(np.argmax(z > 5.0))] = 9.15
        return depth
    found = ghosts(rays_of(np.arange(12), sill))
    edge = int(np.argmax(1.9 + 9.0 * np.tan(ANGLES) > 5.0))
    assert found[:, edge].all() and found.sum() == 12


@pytest.mark.parametrize('depth', [
    lambda x, z: np.full(len(z), 9.0),                       # a wall
    lambda x, z: np.full(len(z), 9.0 + x),                   # one at 45 degrees
    lambda x, z: 9.0 + 0.5 * np.maximum(z - 4.0, 0.0),       # a roof
    lambda x, z: np.full(len(z), 9.0 if x < 2.0 else 9.3),   # a corner
    lambda x, z: np.where(z < 4.0, 9.0, 10.0),               # a balcony
])
def test_surfaces_are_left_alone(depth: Depth) -> None:
    # 10 mm of noise: a point would have to be four deviations off two neighbours at once
    assert not ghosts(rays_of(np.arange(40), depth, noise=0.01)).any()


def test_a_vehicle_that_stands_marks_nothing_between_lines() -> None:
    def flicker(x: float, z: Array) -> Array:
        return 9.0 + 0.1 * (np.arange(len(z)) > 20)
    assert not ghosts(rays_of(np.arange(200), flicker, step=0.0)).any()


def test_lines_far_apart_are_not_compared() -> None:
    assert not ghosts(rays_of(np.arange(0, 400, 20), window, step=0.005)).any()


def test_a_scanner_that_fell_silent_is_not_waited_for() -> None:
    finder = GhostFinder([SIDE, SIDE])
    for k in range(0, 3000, 10):
        rays = rays_of(np.arange(k, k + 10), window)
        if k < 20:
            rays.ring[:] = 1
        finder.mark(rays, np.zeros(len(rays), np.uint8))
    assert len(pickle.dumps(finder)) < 150_000       # and not the classes of 165 000 points more


def test_the_road_is_left_alone() -> None:
    rays = rays_of(np.arange(40), window)
    label = np.full(len(rays), GROUND, np.uint8)
    GhostFinder([SIDE]).mark(rays, label)
    assert (label == GROUND).all()
