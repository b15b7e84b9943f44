# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
What vertical scan lines tell of the vehicle's attitude: the road below and the walls beside.

Each line gives at most one statement of the road and one of every long piece of wall, linear in
the state x = (roll, pitch, heave, crossfall, slope, lean) of `attitude`:

road    z + y roll - x pitch + heave - y crossfall = 0 for its points (x, y, z) in base_link,
wall    dt/dv = (n_y roll - n_x (pitch + slope) + lean) / (n . a) for its slope in the scan plane,
        with the wall's horizontal normal n in base_link and the plane's horizontal direction a.

Roll is that from upright, crossfall the road's below it; pitch is that from the road, and slope,
positive downhill, the road's from level: a path in the plane has no place for hills.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
import math

import numba
import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.labels import label_line
from stri_mapping.facade.points import Rays
from stri_mapping.facade.scan_lines import (
    COUNT,
    DIR_T,
    DIR_V,
    find_runs,
    FIRST,
    LAST,
    LENGTH,
    MEAN_T,
    MEAN_V,
    RMS,
    RUN_FIELDS,
)
from stri_mapping.vehicle import Scanner

Array = NDArray[np.float64]

STATE = 6
CROSSFALL, SLOPE, LEAN = 3, 4, 5
# How uneven a road is at the scale of a scan line, with the range noise, metres.
ROAD_SIGMA = 0.02
# Road is looked for this near to base_link's z = 0, metres, no steeper than this in the vehicle.
ROAD_HEIGHT, ROAD_SLOPE = 0.3, 0.12
# It is used where it is met at up to 65 degrees: beyond, the near side of slanted footprints
# reads high, by 6 mm at 75 degrees.
ROAD_INCIDENCE = 2.15
ROAD_RAYS, ROAD_LENGTH = 8, 0.6
# A wall tells the upright from this length on, metres, if it leans less than this.
WALL_LENGTH, WALL_LEAN = 1.2, 0.09
# Steepest elevation of a wall's middle: the same pull bends walls that are met at more.
WALL_ELEVATION = 1.2
# Smallest standard deviation of a wall's slope, radians: plaster is not planed.
WALL_SIGMA = np.deg2rad(0.1)
# A wall's direction follows from the last lines' runs within this many metres.
FEET, NEAR = 64, 1.5


@dataclass(frozen=True, eq=False)
class Evidence:
    """
    Statements about the state, one a row; see `attitude` for how they are used.

    Attributes
    ----------
    stamps_ns
        (k,) time of each.
    normal, vector
        (k, 5, 5) and (k, 5) its normal equations: information and information times state.
    check, value
        (k, 5) and (k,) the statement in short, ``check . x = value``, by which outliers are told.
    scale
        (k,) how far off an ordinary statement may be, in units of `value`.

    """

    stamps_ns: NDArray[np.int64]
    normal: Array
    vector: Array
    check: Array
    value: Array
    scale: Array

    def take(self, index: NDArray[np.intp]) -> Evidence:
        """Return some of the statements."""
        return Evidence(*(getattr(self, name)[index] for name in FIELDS))


FIELDS = tuple(field.name for field in fields(Evidence))


def join(pieces: Sequence[Evidence]) -> Evidence:
    """Return all statements of at least one piece, in order."""
    return Evidence(*(np.concatenate([getattr(p, name) for p in pieces]) for name in FIELDS))


class Surveyor:
    """
    Looks through scan lines for what is straight in them, and names every point's class.

    Parameters
    ----------
    scanners
        The vertical scanners.

    """

    def __init__(self, scanners: Sequence[Scanner]) -> None:
        """Take the scanners' planes."""
        self._planes = np.array([scan_plane(s.T_base_laser) for s in scanners]).reshape(-1, 3, 3)
        self._feet = np.full((len(scanners), FEET, 2), np.inf)
        self._next = np.zeros(len(scanners), dtype=np.int64)
        self._facades = np.full((len(scanners), 4), np.inf)

    def survey(self, rays: Rays) -> tuple[Evidence, NDArray[np.uint8]]:
        """Return what some lines tell, in their order, and the class (n,) of each point."""
        room = 8 * (len(rays.first) - 1)
        at, label = np.empty(room, np.int64), np.empty(len(rays), np.uint8)
        normal, vector = np.zeros((room, STATE, STATE)), np.zeros((room, STATE))
        check, value, scale = np.zeros((room, STATE)), np.zeros(room), np.zeros(room)
        k = _survey(rays.base, rays.poses, rays.ring, rays.first, self._planes, self._feet,
                    self._next, self._facades, label, at, normal, vector, check, value, scale)
        return Evidence(rays.stamps_ns[at[:k]], normal[:k], vector[:k], check[:k], value[:k],
                        scale[:k]), label


def scan_plane(T_base_laser: Array) -> Array:
    """
    Return origin, horizontal and upward direction (3, 3) of a scan plane in base_link.

    The horizontal direction points to where the scanner looks; of a level plane, which shows
    neither road nor walls upright, the laser's own axes are taken.
    """
    x, z, origin = T_base_laser[:3, 0], T_base_laser[:3, 2], T_base_laser[:3, 3]
    across = np.cross([0.0, 0.0, 1.0], z)
    if np.linalg.norm(across) < 0.5:
        return np.stack([origin, x, T_base_laser[:3, 1]])
    across *= (-1.0 if across @ x < 0.0 else 1.0) / np.linalg.norm(across)
    up = np.cross(z, across)
    return np.stack([origin, across, up if up[2] > 0.0 else -up])


@numba.njit(cache=True)
def _survey(  # type: ignore[no-untyped-def]
    base, poses, ring, first, planes, feet, following, facades, label, at, normal, vector, check,
    value, scale,
):
    """Survey all lines; return the number of statements written."""
    k, lines = 0, len(first) - 1
    longest = 0
    for i in range(lines):
        longest = max(longest, first[i + 1] - first[i])
    t, v = np.empty(longest), np.empty(longest)
    member, runs = np.empty(longest, np.int32), np.empty((longest + 1, RUN_FIELDS))
    for i in range(lines):
        begin, n = first[i], first[i + 1] - first[i]
        if n == 0:
            continue
        points, r = base[begin:begin + n], ring[begin]
        plane = planes[r]
        _in_plane(points, plane, t, v)
        count = find_runs(t[:n], v[:n], runs, member[:n])
        label_line(points, t[:n], runs[:count], member[:n], facades[r], label[begin:begin + n])
        for q in range(count):          # the nearest road, and with it the widest
            if k < len(at) and _is_road(runs[q], points) and _road(
                    points, runs[q], q, member, plane, normal[k], vector[k], check[k]):
                at[k] = begin + _middle(runs[q])
                # one that lies off by more is a pavement, or the roof of a car
                value[k], scale[k] = check[k, 2], 0.05
                check[k, 2] = 1.0
                k += 1
                break
        if plane[2, 2] < 0.99:          # in slanted planes walls do not stand upright
            continue
        for q in range(count):
            if k < len(at) and _is_wall(runs[q]) and _wall(
                    runs[q], points, poses[begin:begin + n], plane, feet[r], following, r,
                    normal[k], vector[k], check[k]):
                at[k] = begin + _middle(runs[q])
                value[k], scale[k] = runs[q, DIR_T] / runs[q, DIR_V], math.radians(0.5)
                k += 1
    return k


@numba.njit(cache=True)
def _in_plane(points, plane, t, v):  # type: ignore[no-untyped-def]
    """Write the places of points (n, 3) in the scan plane."""
    at, across, up = plane
    for j in range(len(points)):
        x, y, z = points[j, 0] - at[0], points[j, 1] - at[1], points[j, 2] - at[2]
        t[j] = x * across[0] + y * across[1] + z * across[2]
        v[j] = x * up[0] + y * up[1] + z * up[2]


@numba.njit(cache=True, inline='always')
def _middle(run):  # type: ignore[no-untyped-def]
    return int(0.5 * (run[FIRST] + run[LAST]))


@numba.njit(cache=True)
def _is_road(run, points):  # type: ignore[no-untyped-def]
    z = points[_middle(run), 2]
    return (run[COUNT] >= ROAD_RAYS and run[LENGTH] >= ROAD_LENGTH
            and abs(run[DIR_V]) < ROAD_SLOPE and abs(z) < ROAD_HEIGHT)


@numba.njit(cache=True)
def _is_wall(run):  # type: ignore[no-untyped-def]
    return (run[LENGTH] >= WALL_LENGTH and abs(run[DIR_T]) < WALL_LEAN * run[DIR_V]
            and run[MEAN_V] < WALL_ELEVATION * abs(run[MEAN_T]))


@numba.njit(cache=True)
def _road(  # type: ignore[no-untyped-def]
    points, run, number, member, plane, normal, vector, check,
):
    """Write the statement of the road; the value goes where check has 1, for the heave."""
    normal[:], vector[:], check[:] = 0.0, 0.0, 0.0
    n, sx, sy, sz, xx, xy, yy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(int(run[FIRST]), int(run[LAST]) + 1):
        x, y, z = points[j, 0], points[j, 1], points[j, 2]
        out = math.sqrt((x - plane[0, 0]) ** 2 + (y - plane[0, 1]) ** 2)
        if member[j] != number or out > ROAD_INCIDENCE * (plane[0, 2] - z):
            continue
        n, sx, sy, sz = n + 1.0, sx + x, sy + y, sz + z
        xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
    if n < ROAD_RAYS:
        return False
    # sums over the points of (y, -x, 1, -y), of its square and of its product with -z
    single, by_height = (sy, -sx, n, -sy), (-yz, xz, -sz, yz)
    square = ((yy, -xy, sy, -yy), (-xy, xx, -sx, xy), (sy, -sx, n, -sy), (-yy, xy, -sy, yy))
    for a in range(4):
        vector[a] = by_height[a] / ROAD_SIGMA**2
        check[a] = single[a] / n
        for b in range(4):
            normal[a, b] = square[a][b] / ROAD_SIGMA**2
    check[2] = -sz / n
    return True


@numba.njit(cache=True)
def _wall(  # type: ignore[no-untyped-def]
    run, points, poses, plane, feet, following, ring, normal, vector, check,
):
    """Write the statement of a wall whose direction the lines before this one tell."""
    pose = poses[_middle(run)]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x = plane[0, 0] + run[MEAN_T] * plane[1, 0]
    y = plane[0, 1] + run[MEAN_T] * plane[1, 1]
    foot_x, foot_y = pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y
    along = _direction(feet, foot_x, foot_y)
    place = following[ring] % FEET
    feet[place, 0], feet[place, 1] = foot_x, foot_y
    following[ring] += 1
    if along > 9.0:
        return False
    # normal in base_link, away from the scanner
    n_x, n_y = -math.sin(along - pose[2]), math.cos(along - pose[2])
    facing = (n_x * plane[1, 0] + n_y * plane[1, 1]) * (1.0 if run[MEAN_T] > 0.0 else -1.0)
    if facing < 0.0:
        n_x, n_y, facing = -n_x, -n_y, -facing
    if facing < 0.4:
        return False
    away = n_x * plane[1, 0] + n_y * plane[1, 1]
    normal[:], vector[:], check[:] = 0.0, 0.0, 0.0
    check[0], check[1], check[SLOPE] = n_y / away, -n_x / away, -n_x / away
    check[LEAN] = 1.0 / away
    slope = run[DIR_T] / run[DIR_V]
    variance = WALL_SIGMA**2 + 12.0 * run[RMS] ** 2 / (run[COUNT] * run[LENGTH] ** 2)
    for a in range(STATE):
        vector[a] = check[a] * slope / variance
        for b in range(STATE):
            normal[a, b] = check[a] * check[b] / variance
    return True


@numba.njit(cache=True)
def _direction(feet, x, y):  # type: ignore[no-untyped-def]
    """Return the direction of the wall through some of the feet and (x, y); 10 where unclear."""
    n, sx, sy, xx, xy, yy = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(feet)):
        dx, dy = feet[i, 0] - x, feet[i, 1] - y
        if dx * dx + dy * dy < NEAR * NEAR:
            n += 1.0
            sx += dx
            sy += dy
            xx += dx * dx
            xy += dx * dy
            yy += dy * dy
    xx, xy, yy = xx / n - (sx / n) ** 2, xy / n - sx * sy / n**2, yy / n - (sy / n) ** 2
    root = math.hypot(0.5 * (xx - yy), xy)
    large, small = 0.5 * (xx + yy) + root, 0.5 * (xx + yy) - root
    if n < 5.0 or large < 0.15**2 or small > 0.04**2:
        return 10.0
    return 0.5 * math.atan2(2.0 * xy, xx - yy)
