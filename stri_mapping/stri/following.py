# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Step 2 of the paper, over time: surfaces that keep their number while they are in view.

A ray that meets about the same range as the scan before at its bearing meets the same surface, a
moment later, and the rest of its piece follows it.  So surfaces that touch for a moment stay
apart.  A face that something in front cuts keeps its number on both sides, and what comes out
from behind that, in line with it, is more of it.  Pieces of one number that nothing in front has
cut are surfaces of their own: somebody who walks away from a car, a house beyond a yard.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Labels = NDArray[np.int32]

UNLABELLED, NEW = -1, -2
# Metres of range, and by range, within which a surface is met again.
SAME, SAME_PER_RANGE = 0.06, 0.02
MIN_RAYS = 3            # of a piece
# Radians that something in front may hide of a face, and of the face by which its line is told,
# by so many rays at the least.
HIDDEN, LEVER, FACE = 0.5, 0.2, 6


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def follow(
    ranges: Array, angles: Array, pieces: Labels, ranges_before: Array, labels_before: Labels,
    moved: float, surfaces: int, labels: Labels,
) -> int:
    """
    Give the rays of a scan the numbers of the surfaces they continue.

    Parameters
    ----------
    ranges, angles, pieces
        (n,) metres, NaN where there is none, radians, and the piece each ray belongs to.
    ranges_before, labels_before
        (n,) of the scan before.
    moved
        Metres by which a surface may have come nearer or gone away since.
    surfaces
        Numbers given so far.
    labels
        (n,) written with the numbers, `UNLABELLED` for rays on no piece.

    Returns
    -------
    int
        Numbers given so far, the new ones included.

    """
    n = len(ranges)
    labels[:] = UNLABELLED
    start = 0
    while start < n:
        end = _end(pieces, start)
        if pieces[start] != UNLABELLED:
            for j in range(start, end):
                labels[j] = _before(ranges[j], j, ranges_before, labels_before, moved)
            if not _fill(labels, start, end):
                labels[start:end] = NEW
        start = end
    start = 0
    while start < n:
        end = _end(pieces, start)
        if labels[start] == NEW:
            number = _beyond(ranges, angles, pieces, labels, start, -1)
            if number == UNLABELLED:
                number = _beyond(ranges, angles, pieces, labels, end - 1, 1)
            if number == UNLABELLED:
                number = surfaces
                surfaces += 1
            labels[start:end] = number
        start = end
    return surfaces


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _end(pieces: Labels, start: int) -> int:
    """Return the ray after the piece that begins at a ray."""
    end = start + 1
    while end < len(pieces) and pieces[end] == pieces[start]:
        end += 1
    return end


@numba.njit(cache=True, inline='always')  # type: ignore[untyped-decorator]
def _before(
    r: float, j: int, ranges_before: Array, labels_before: Labels, moved: float,
) -> int:
    """Return the number of the surface that was met at a ray's bearing or beside it before."""
    for k in (j, j - 1, j + 1):
        if (0 <= k < len(labels_before) and labels_before[k] != UNLABELLED
                and abs(r - ranges_before[k]) < SAME + SAME_PER_RANGE * r + moved):
            return int(labels_before[k])
    return UNLABELLED


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _fill(labels: Labels, start: int, end: int) -> bool:
    """
    Give every ray of a piece a number, that of the nearest followed run; tell if there is one.

    Surfaces that touch for a moment stay apart by this, and take their own numbers with them when
    they part.  Numbers that only a ray or two have are strays at an edge.
    """
    longest = _strays(labels, start, end)
    if longest == 0:
        return False
    last = UNLABELLED
    for j in range(start, end):
        if labels[j] == UNLABELLED:
            labels[j] = last
        last = labels[j]
    for j in range(end - 1, start - 1, -1):
        if labels[j] == UNLABELLED:
            labels[j] = last
        last = labels[j]
    return True


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _strays(labels: Labels, start: int, end: int) -> int:
    """Remove the numbers of runs shorter than others by far; return the longest run."""
    longest, j = 0, start
    while j < end:
        k = j
        while k < end and labels[k] == labels[j]:
            k += 1
        if labels[j] != UNLABELLED:
            longest = max(longest, k - j)
        j = k
    j = start
    while j < end:
        k = j
        while k < end and labels[k] == labels[j]:
            k += 1
        if k - j < MIN_RAYS and k - j < longest:
            labels[j:k] = UNLABELLED
        j = k
    return longest


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _beyond(
    ranges: Array, angles: Array, pieces: Labels, labels: Labels, edge: int, way: int,
) -> int:
    """
    Return the number of the face that goes on in a piece, behind something in front of both.

    It is looked for from the piece's edge to one side, way = 1 or -1; `UNLABELLED` if there is
    none.
    """
    n, j = len(ranges), edge + way
    while 0 <= j < n and abs(angles[j] - angles[edge]) < HIDDEN:
        told = k = j                # first and last ray that tell the line, last of the piece
        while 0 <= k < n and pieces[k] == pieces[j]:
            if abs(angles[k] - angles[j]) < LEVER:
                told = k
            k += way
        if labels[j] >= 0 and abs(told - j) >= FACE and j != edge + way and (
                _in_line(ranges, angles, edge, j, told, way)):
            return int(labels[j])
        j = k
    return UNLABELLED


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _in_line(ranges: Array, angles: Array, edge: int, j: int, k: int, way: int) -> bool:
    """
    Tell whether the line through rays j and k goes on at ray edge and is hidden between.

    Along a line 1/r = a cos + b sin of the bearing.  A piece has `MIN_RAYS` rays or more.
    """
    cj, sj = math.cos(angles[j]), math.sin(angles[j])
    ck, sk = math.cos(angles[k]), math.sin(angles[k])
    det = cj * sk - ck * sj
    a = (sk / ranges[j] - sj / ranges[k]) / det
    b = (cj / ranges[k] - ck / ranges[j]) / det
    m = edge - (MIN_RAYS - 1) * way
    while m != j:
        inverse = a * math.cos(angles[m]) + b * math.sin(angles[m])
        if inverse <= 0.0:
            return False
        off, limit = ranges[m] - 1.0 / inverse, SAME + SAME_PER_RANGE / inverse
        if off > limit or (off < -limit and (edge - m) * way >= 0):
            return False
        m += way
    return True


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def part(
    ranges: Array, pieces: Labels, surfaces: int, labels: Labels,
) -> tuple[int, Labels]:
    """
    Give pieces of a number that nothing in front has cut numbers of their own.

    The longest piece keeps the number.

    Parameters
    ----------
    ranges, pieces, surfaces
        See `follow`.
    labels
        (n,) changed in place.

    Returns
    -------
    surfaces : int
        Numbers given so far, the new ones included.
    parts : Labels
        (k, 2) new numbers, and those they had been part of.

    """
    runs = _runs(pieces, labels)
    parts = np.empty_like(runs)
    count = 0
    for i in range(len(runs)):
        number = labels[runs[i, 0]]
        longest = i
        for k in range(len(runs)):
            if labels[runs[k, 0]] == number and (
                    runs[k, 1] - runs[k, 0] > runs[longest, 1] - runs[longest, 0]):
                longest = k
        first, last = min(i, longest), max(i, longest)
        apart = pieces[runs[first, 0]] != pieces[runs[last, 0]]
        if apart and not _cut(ranges, runs[first, 1] - 1, runs[last, 0]):
            labels[runs[i, 0]:runs[i, 1]] = surfaces
            parts[count, 0], parts[count, 1] = surfaces, number
            surfaces, count = surfaces + 1, count + 1
    return surfaces, parts[:count]


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _runs(pieces: Labels, labels: Labels) -> Labels:
    """Return first ray and the one after the last (k, 2) of each run of a number in a piece."""
    runs = np.empty((len(labels), 2), np.int32)
    count = 0
    for j in range(len(labels)):
        if labels[j] == UNLABELLED:
            continue
        if j > 0 and labels[j] == labels[j - 1] and pieces[j] == pieces[j - 1]:
            runs[count - 1, 1] = j + 1
        else:
            runs[count, 0], runs[count, 1] = j, j + 1
            count += 1
    return runs[:count]


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _cut(ranges: Array, first: int, last: int) -> bool:
    """Tell whether there are rays between two, and all are nearer, or without a return."""
    least = min(ranges[first], ranges[last])
    for j in range(first + 1, last):
        if ranges[j] > least:
            return False
    return last > first + 1
