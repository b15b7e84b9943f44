# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Cosines and sines of angles that are small, or near the one before them: those of rays."""

from __future__ import annotations

import math

import numba
import numpy as np

# Largest angle for which the series are good to 1e-15, radians.
SMALL = 0.02


@numba.njit(cache=True, inline='always')
def cos_sin(angle):  # type: ignore[no-untyped-def]
    """Return cosine and sine; of small angles by their series, to 1e-15."""
    if abs(angle) > SMALL:
        return math.cos(angle), math.sin(angle)
    q = angle * angle
    # products, which cost a quarter of quotients
    return (1.0 - q * (1.0 / 2.0 - q * (1.0 / 24.0 - q * (1.0 / 720.0))),
            angle * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q * (1.0 / 5040.0)))))


@numba.njit(cache=True, inline='always')
def heading(yaw, known):  # type: ignore[no-untyped-def]
    """
    Return cosine and sine of a yaw from those of the multiple of `SMALL` that is nearest.

    That one, with its cosine and sine, is kept in `known` (3,), which begins as NaN: the vehicle
    turns by milliradians from line to line.  What was asked before has no effect on the result.
    """
    near = SMALL * np.rint(yaw * (1.0 / SMALL))
    if known[0] != near:
        known[0], known[1], known[2] = near, math.cos(near), math.sin(near)
    c, s = cos_sin(yaw - near)
    return known[1] * c - known[2] * s, known[2] * c + known[1] * s
