# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What moves is told from what stands, by where rays went through before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
import pytest

from stri_mapping.facade.free_space import FreeSpace
from stri_mapping.facade.points import Rays

Array = NDArray[np.float64]
TURN_NS = 13_320_000
ORIGIN = np.array([[0.0, 0.6, 1.9]])


def line(k: int, x: float, box: tuple[float, float] | None) -> Rays:
    """Return a line square to the drive: road, wall at y = 9, and a box 1.5 m high from y to y."""
    angles = np.deg2rad(np.arange(-89.0, 60.0))
    y = np.minimum(np.where(angles < 0.0, -1.9 / np.minimum(np.tan(angles), -1e-9), np.inf), 8.4)
    z = 1.9 + y * np.tan(angles)
    if box is not None:
        near = box[0] - 0.6
        height = 1.9 + near * np.tan(angles)
        hit = (y > near) & (height > 0.0) & (height < 1.5)
        y, z = np.where(hit, near, y), np.where(hit, height, z)
    n = len(y)
    base = np.column_stack([np.zeros(n), y + 0.6, z])
    return Rays(base, np.tile([x, 0.0, 0.0], (n, 1)), np.full(n, k * TURN_NS), np.zeros(
        n, np.float32), np.zeros(n, np.uint16), np.array([0, n]))


@pytest.mark.parametrize('start', [0.0, 1e4, -777.7])
def test_what_comes_is_marked_and_what_stands_is_not(start: float) -> None:
    space = FreeSpace(ORIGIN)
    for k in range(80):                          # the street, while the vehicle creeps along it
        assert not space.moving(line(k, start + 0.01 * k, None)).any()
    for k in range(80, 110):                     # something has driven into the view
        rays = line(k, start + 0.4, (4.1, 5.5))
        marked = space.moving(rays)
        box = np.abs(rays.base[:, 1] - 4.1) < 1e-6
        assert marked[box & (rays.base[:, 2] > 0.3)].all()
        assert not marked[~box].any()


def test_what_was_there_from_the_start_is_never_marked() -> None:
    space = FreeSpace(ORIGIN)
    for k in range(200):
        assert not space.moving(line(k, 0.02 * k, (4.0, 5.5))).any()


def test_the_past_is_forgotten() -> None:
    space = FreeSpace(ORIGIN)
    for k in range(80):
        space.moving(line(k, 0.01 * k, None))
    later = int(60e9 / TURN_NS)                  # a minute later a car has been parked there
    for k in range(later, later + 60):
        assert not space.moving(line(k, 0.4, (4.0, 5.5))).any()
