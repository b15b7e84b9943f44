# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Classes of points by what surrounds them in their scan line."""

from __future__ import annotations

import math

import numba

from stri_mapping.facade.points import FACADE, GROUND, NOISE, OTHER, VEGETATION
from stri_mapping.facade.scan_lines import COUNT, DIR_T, DIR_V, FIRST, LAST, LENGTH, MEAN_T

# Ground is a run that is nearly level and this near to base_link's z = 0, metres.
GROUND_HEIGHT, GROUND_SLOPE = 0.35, 0.15
# A facade is a run that stands upright, this long, and reaches above vans, buses and tree
# trunks, metres.
FACADE_LENGTH, FACADE_TOP, FACADE_LEAN = 1.5, 3.3, 0.1
# A line without one, in a row of shop windows or behind a tree, takes that of the lines before,
# up to so many lines ago.
MEMORY = 60
# What belongs to it may be this much nearer (balconies) or further back (windows, doors), metres.
RELIEF = 1.2
# Points above this height that form no run are leaves, below it they are anything, metres.
LEAVES = 1.0
# A ghost is further than this from both of its neighbours in range, metres.
GHOST = 0.1


@numba.njit(cache=True)
def label_line(  # type: ignore[no-untyped-def]
    points, t, runs, member, remembered, label,
):
    """
    Write the class of each point of one scan line.

    Parameters
    ----------
    points
        (n, 3) in base_link, metres.
    t
        (n,) horizontal distance from the scanner, metres.
    runs, member
        What `find_runs` made of the line.
    remembered
        (2,) distance of the scanner's last facade and how many lines ago that was; updated.
    label
        (n,) written.

    """
    n = len(points)
    depth = _facade_depth(points, runs)
    if depth < math.inf:
        remembered[0], remembered[1] = depth, 0.0
    elif remembered[1] < MEMORY:
        depth = remembered[0]
    remembered[1] += 1.0
    for j in range(n):
        near = abs(t[j] - depth) < RELIEF
        if near and points[j, 2] > GROUND_HEIGHT:
            label[j] = FACADE
        elif points[j, 2] > LEAVES:
            label[j] = VEGETATION
        else:
            label[j] = OTHER
    for q in range(len(runs)):
        code = _run_class(runs[q], points, depth)
        if code:
            for j in range(int(runs[q, FIRST]), int(runs[q, LAST]) + 1):
                if member[j] == q:
                    label[j] = code
    for j in range(1, n - 1):
        if member[j] < 0 and member[j - 1] >= 0 and member[j + 1] >= 0 and _is_ghost(
                points, j):
            label[j] = NOISE


@numba.njit(cache=True)
def _facade_depth(points, runs):  # type: ignore[no-untyped-def]
    """Return the horizontal distance of the longest upright run that is high enough, or inf."""
    depth, longest = math.inf, FACADE_LENGTH
    for q in range(len(runs)):
        run = runs[q]
        top = max(points[int(run[FIRST]), 2], points[int(run[LAST]), 2])
        if run[LENGTH] > longest and top > FACADE_TOP and (
                abs(run[DIR_T]) < FACADE_LEAN * run[DIR_V]):
            depth, longest = run[MEAN_T], run[LENGTH]
    return depth


@numba.njit(cache=True)
def _run_class(run, points, depth):  # type: ignore[no-untyped-def]
    """Return the class of a run's points, 0 where its points are judged one by one."""
    low = points[int(run[FIRST]), 2]
    high = points[int(run[LAST]), 2]
    if abs(run[DIR_V]) < GROUND_SLOPE and max(abs(low), abs(high)) < GROUND_HEIGHT:
        return GROUND
    if abs(run[MEAN_T] - depth) < RELIEF:
        return FACADE
    upright = abs(run[DIR_T]) < FACADE_LEAN * run[DIR_V]
    if upright and run[LENGTH] > FACADE_LENGTH and max(low, high) > FACADE_TOP:
        return FACADE
    if run[COUNT] > 4.0:
        return OTHER
    return 0


@numba.njit(cache=True)
def _is_ghost(points, j):  # type: ignore[no-untyped-def]
    """Return whether a point hangs in the air between what its neighbours hit."""
    before = _distance(points, j, j - 1)
    after = _distance(points, j, j + 1)
    reach = _distance(points, j - 1, j + 1)
    return min(before, after) > GHOST and max(before, after) < reach


@numba.njit(cache=True)
def _distance(points, i, j):  # type: ignore[no-untyped-def]
    return math.sqrt((points[i, 0] - points[j, 0]) ** 2 + (points[i, 1] - points[j, 1]) ** 2
                     + (points[i, 2] - points[j, 2]) ** 2)
