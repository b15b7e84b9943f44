# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Distances to true surfaces, against a slow search over every triangle."""

from __future__ import annotations

import numpy as np

from stri_mapping.simulation.nearest import Surfaces


def test_nearest_points_are_those_of_a_search_over_dense_samples() -> None:
    rng = np.random.default_rng(1)
    corner = rng.uniform(-3.0, 3.0, (25, 1, 3))
    triangles = corner + rng.normal(0.0, 1.0, (25, 3, 3))
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 120), np.linspace(0.0, 1.0, 120))
    inside = u + v <= 1.0
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    samples = (a[:, None] + u[inside][:, None] * (b - a)[:, None]
               + v[inside][:, None] * (c - a)[:, None]).reshape(-1, 3)
    points = samples[rng.integers(0, len(samples), 200)] + rng.normal(0.0, 0.1, (200, 3))
    found = np.linalg.norm(points - Surfaces(triangles, reach=0.5).nearest(points), axis=1)
    for point, distance in zip(points, found):
        slow = np.sqrt(np.min(np.sum((samples - point) ** 2, axis=1)))
        assert distance <= slow + 1e-9
        assert slow - distance < 0.02              # samples are 1 to 3 cm apart


def test_what_is_out_of_reach_has_no_nearest_point() -> None:
    triangle = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    got = Surfaces(triangle, reach=0.3).nearest(
        np.array([[0.2, 0.2, 0.29], [0.2, 0.2, 0.31], [50.0, 0.0, 0.0], [-0.1, 0.5, 0.0]]))
    np.testing.assert_allclose(got[0], [0.2, 0.2, 0.0], atol=1e-12)
    np.testing.assert_allclose(got[3], [0.0, 0.5, 0.0], atol=1e-12)
    assert np.all(np.isnan(got[1:3]))
