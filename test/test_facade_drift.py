# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Residual yaw and sideways wander of the path, told by walls that several scanners see."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from test_facade_stabiliser import ROAD, scan_at, SPEED, T0, TURN_NS, VERTICALS, WALL

from stri_mapping import geometry
from stri_mapping.facade.drift import DriftCorrector
from stri_mapping.facade.points import FACADE, FacadePoints
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.vehicle import Scanner

Array = NDArray[np.float64]
Error = Callable[[Array], Array]


def still(seconds: float) -> tuple[float, float, float]:
    return 0.0, 0.0, 0.0


def mapped(error: Error, planes: list[tuple[Array, float]], seconds: float = 8.0,
           mounts: tuple[Scanner, ...] = VERTICALS) -> tuple[FacadeAligner, FacadePoints, Array]:
    """Drive straight past planes with an error (n, 3) in the path; return what comes of it."""
    rng, aligner = np.random.default_rng(0), FacadeAligner(mounts)
    stamps = T0 + np.arange(int(seconds * 1e9 / TURN_NS)) * TURN_NS
    for stamp in stamps[:-1].tolist():
        for ring, mount in enumerate(mounts):
            aligner.add_scan(ring, scan_at(mount, stamp + ring * 4_000_000, still, planes, rng))
    t = (stamps - T0) * 1e-9
    true = np.column_stack([SPEED * t, 0.0 * t, 0.0 * t])
    aligner.add_poses(stamps, geometry.compose(true, error(t)))
    aligner.finish()
    points, (_, poses) = aligner.take_points(), aligner.take_poses()
    return aligner, points, geometry.compose(geometry.inverse(true), poses[:, [0, 1, 5]])


def wobble(t: Array) -> Array:
    """Return 0.15 degrees of yaw swinging within 2.5 s, as parked cars make a path do."""
    return np.column_stack([0.0 * t, 0.0 * t, np.deg2rad(0.15) * np.sin(2.0 * np.pi * t / 2.5)])


def off_wall(points: FacadePoints) -> float:
    high = (points.label == FACADE) & (points.xyz[:, 2] > 0.5)
    return float(np.std(points.xyz[high, 1]))


def test_a_wobbling_path_is_calmed(monkeypatch) -> None:
    aligner, corrected, left = mapped(wobble, [ROAD, WALL])
    # the scanner ahead sees the wall two seconds before the others: nothing is told at first
    assert aligner.counts.yaw_told > 0.3 * len(corrected) > 10_000
    assert aligner.counts.points == len(corrected)
    monkeypatch.setattr('stri_mapping.facade.push_broom.DriftCorrector',
                        lambda rings: DriftCorrector(0))
    _, plain, before = mapped(wobble, [ROAD, WALL])
    # the noise is 10 mm; scanners that look 9 m ahead and back add 17 mm of wobble
    assert off_wall(corrected) < 0.85 * off_wall(plain)
    inner = slice(150, -100)                     # the first wall has nothing to be held against
    assert np.std(left[inner, 2]) < 0.8 * np.std(before[inner, 2])


def test_a_good_path_is_left_alone() -> None:
    _, points, left = mapped(lambda t: np.zeros((len(t), 3)), [ROAD, WALL])
    # ranges of 10 mm by the thousand: corrections of noise alone
    assert np.abs(left[:, 1]).max() < 0.002
    assert np.rad2deg(np.abs(left[:, 2]).max()) < 0.02
    assert off_wall(points) < 0.0105


def test_without_walls_nothing_is_corrected() -> None:
    aligner, points, left = mapped(wobble, [ROAD], 4.0)
    assert aligner.counts.yaw_told == 0
    t = np.arange(len(left)) * TURN_NS * 1e-9
    np.testing.assert_allclose(left[:, 2], wobble(t)[:, 2], atol=1e-9)
    assert len(points) > 10_000


def test_one_scanner_has_nothing_to_be_compared_with() -> None:
    aligner, points, left = mapped(wobble, [ROAD, WALL], 3.0, VERTICALS[1:2])
    assert aligner.counts.yaw_told == 0
    assert aligner.counts.points == len(points)
    t = np.arange(len(left)) * TURN_NS * 1e-9
    np.testing.assert_allclose(left[:, 2], wobble(t)[:, 2], atol=1e-9)
