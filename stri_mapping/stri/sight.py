# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Lines of sight: where rays went through, nothing stood.

A return from a place that an earlier keyframe saw through comes from something that has moved
there since.  That holds whatever its shape, and needs no surface to be recognised again.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.stri.keyframe import sector
from stri_mapping.stri.rays import BEARING, LABEL, RANGE, TIME
from stri_mapping.stri.spline import pose_at
from stri_mapping.stri.surfel import S_LABEL, X, Y

Array = NDArray[np.float64]

# metres by which rays must have gone on beyond a place, with its distance, to have seen through
CLEAR, CLEAR_PER_RANGE = 0.3, 0.05
NEAR = 30.0               # metres; beyond, rays are too far from one another


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def count_through(
    rays: Array, stride: int, knots: Array, h: float, pose: Array, sight: Array, votes: Array,
) -> None:
    """
    Count the returns from places that an earlier keyframe saw through.

    Parameters
    ----------
    rays
        (n, RAY) prepared rays, of which every stride-th is looked at.
    knots, h
        The spline that tells where the scanner was.
    pose, sight
        (3,) and (SIGHTS,) of the earlier keyframe.
    votes
        (labels,) to which one is added for each, by its label modulo the length.

    """
    weights, at = np.empty(4), np.empty(3)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for i in range(0, len(rays), stride):
        r, label = rays[i, RANGE], int(rays[i, LABEL])
        if label < 0 or r > NEAR:
            continue
        pose_at(knots, h, rays[i, TIME], weights, at)
        a = rays[i, BEARING] + at[2]
        dx, dy = at[0] + r * math.cos(a) - pose[0], at[1] + r * math.sin(a) - pose[1]
        if _seen_through(cos * dx + sin * dy, -sin * dx + cos * dy, sight):
            votes[label % len(votes)] += 1.0


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def count_left(
    surfels: Array, count: int, stride: int, z: Array, sight: Array, votes: Array,
) -> None:
    """
    Count the surfels of an earlier keyframe in whose place a newer one sees through.

    Parameters
    ----------
    surfels, count
        (m, SURFEL) of the earlier keyframe and how many there are; every stride-th is looked at.
    z
        (3,) pose of the earlier keyframe in the newer one.
    sight
        (SIGHTS,) of the newer one.
    votes
        (labels,) to which one is added for each, by its label modulo the length.

    """
    cos, sin = math.cos(z[2]), math.sin(z[2])
    for i in range(0, count, stride):
        sx, sy, label = surfels[i, X], surfels[i, Y], int(surfels[i, S_LABEL])
        if label >= 0 and sx * sx + sy * sy < NEAR * NEAR and _seen_through(
                z[0] + cos * sx - sin * sy, z[1] + sin * sx + cos * sy, sight):
            votes[label % len(votes)] += 1.0


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _seen_through(x: float, y: float, sight: Array) -> bool:
    d, q = math.hypot(x, y), sector(math.atan2(y, x))
    beyond = d + CLEAR + CLEAR_PER_RANGE * d
    return bool(sight[q - 1] > beyond and sight[q] > beyond
                and sight[(q + 1) % len(sight)] > beyond)
