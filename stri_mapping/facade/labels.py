# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Classes of points by what surrounds them in their scan line."""

from __future__ import annotations

import math

import numba

from stri_mapping.facade.points import FACADE, GROUND, OTHER, VEGETATION
from stri_mapping.facade.scan_lines import COUNT, DIR_T, DIR_V, FIRST, LAST, LENGTH, MEAN_T

# Ground is a run that is nearly level and this near to base_link's z = 0, metres, and so much more
# for every metre aside: roads are crowned.
GROUND_HEIGHT, GROUND_FALL, GROUND_SLOPE = 0.35, 0.03, 0.15
# A facade is a run that stands upright, this long, and reaches above vans, buses and tree
# trunks, metres.
FACADE_LENGTH, FACADE_TOP, FACADE_LEAN = 1.5, 3.3, 0.1
# A line without one, in a row of shop windows or behind a tree, takes that of the lines before,
# up to so many lines ago.
MEMORY = 60
# A lorry's or a bus's side is no higher than this, and light comes through below it at these
# heights, metres: rays there go further by so much.  Where a wheel is, the side is that of the
# lines before, up to so many lines ago.
LORRY_TOP, LORRY_FLOOR, LORRY_ROOF, BELOW, WHEEL = 4.3, 0.3, 1.5, 0.5, 60
# What belongs to a facade may be this much nearer (balconies) or further back (windows, doors),
# metres.
RELIEF = 1.2
# Points above this height that form no run are leaves, below it they are anything, metres.
LEAVES = 1.0


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
        (4,) distance of the scanner's last facade and how many lines ago that was, and the same
        of the last side of a lorry; updated.
    label
        (n,) written.

    """
    n = len(points)
    _find_lorry(points, t, runs, remembered)
    lorry = remembered[2] if remembered[3] < WHEEL else math.inf
    depth = _facade_depth(points, runs, lorry)
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
        code = _run_class(runs[q], points, depth, lorry)
        if code:
            for j in range(int(runs[q, FIRST]), int(runs[q, LAST]) + 1):
                if member[j] == q:
                    label[j] = code


@numba.njit(cache=True)
def _find_lorry(points, t, runs, remembered):  # type: ignore[no-untyped-def]
    """Take note of the side of a lorry: upright, not too high, and nothing below it."""
    remembered[3] += 1.0
    for q in range(len(runs)):
        run = runs[q]
        low, high, down = int(run[FIRST]), int(run[LAST]), -1
        if points[low, 2] > points[high, 2]:
            low, high, down = high, low, 1
        below = low + 2 * down                   # the next ray may have hit the edge
        if (_is_upright(run) and points[high, 2] < LORRY_TOP and 0 <= below < len(points)
                and LORRY_FLOOR < points[low, 2] < LORRY_ROOF
                and t[below] > run[MEAN_T] + BELOW):
            remembered[2], remembered[3] = run[MEAN_T], 0.0


@numba.njit(cache=True, inline='always')
def _is_upright(run):  # type: ignore[no-untyped-def]
    """Return whether a run stands upright and is as long as a facade has to be."""
    return run[LENGTH] > FACADE_LENGTH and abs(run[DIR_T]) < FACADE_LEAN * run[DIR_V]


@numba.njit(cache=True)
def _is_facade(run, points, lorry):  # type: ignore[no-untyped-def]
    """Return whether a run is a facade by itself, and not the side of a lorry (distance)."""
    top = max(points[int(run[FIRST]), 2], points[int(run[LAST]), 2])
    return _is_upright(run) and top > FACADE_TOP and (
        top > LORRY_TOP or abs(run[MEAN_T] - lorry) > 0.3)


@numba.njit(cache=True)
def _facade_depth(points, runs, lorry):  # type: ignore[no-untyped-def]
    """Return the horizontal distance of the longest upright run that is high enough, or inf."""
    depth, longest = math.inf, 0.0
    for q in range(len(runs)):
        if runs[q, LENGTH] > longest and _is_facade(runs[q], points, lorry):
            depth, longest = runs[q, MEAN_T], runs[q, LENGTH]
    return depth


@numba.njit(cache=True)
def _run_class(run, points, depth, lorry):  # type: ignore[no-untyped-def]
    """Return the class of a run's points, 0 where its points are judged one by one."""
    low = points[int(run[FIRST]), 2]
    high = points[int(run[LAST]), 2]
    if abs(run[DIR_V]) < GROUND_SLOPE and max(abs(low), abs(high)) < (
            GROUND_HEIGHT + GROUND_FALL * abs(run[MEAN_T])):
        return GROUND
    if abs(run[MEAN_T] - depth) < RELIEF:
        return FACADE
    if _is_facade(run, points, lorry):
        return FACADE
    if run[COUNT] > 4.0:
        return OTHER
    return 0
