# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Facade elevations as files: orthographic pictures of the planes that facades stand in.

The street is cut where it bends.  On each side of a piece, the vertical plane through its
facades is found, and all that is near it is drawn square to it, by depth and by intensity.  Each
PNG has a world file (.pgw): pixel to metres along the plane and metres above odom.  Thin lines
are the grid of the columns where the facade repeats itself, else one every 10 m.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from stri_mapping.facade.cloud_files import PLY_NAME, read_between
from stri_mapping.facade.pictures import blended, Grid, nearest_depth
from stri_mapping.facade.points import FACADE, NOISE
from stri_mapping.trajectory import Trajectory

Array = NDArray[np.float64]

PATTERN = 'facade_elevation_*.p[ng][gw]'
# A piece ends where the heading has changed by this much, radians, or after so many metres.
BEND, LONGEST, SHORTEST = np.deg2rad(8.0), 120.0, 8.0
# Points seen from so far before and after a piece may belong to it, metres of driving.
REACH = 15.0
# Facade points on a side that make it worth a picture.
ENOUGH = 3000
# Metres of a pixel, of gaps that are closed, and shown in front of and behind the plane.
PIXEL, GAP, FRONT, BACK = 0.04, 0.16, 3.0, 4.0
# Spacing of the grid where no period is found, metres, and the periods looked for.
SPACING, PERIODS = 10.0, (2.5, 12.0)


@dataclass(frozen=True)
class Plane:
    """
    A facade's vertical plane.

    Attributes
    ----------
    x, y
        Its origin in odom, metres.
    heading
        Direction in which metres along the plane count, radians in odom; seen from the street
        it points to the right.
    length, top
        Metres along and above odom's z = 0 of what is shown.
    grid
        Spacing and start of the lines, metres along.
    periodic
        Whether that is the facade's own period.

    """

    x: float
    y: float
    heading: float
    length: float
    top: float
    grid: tuple[float, float]
    periodic: bool

    def coordinates(self, xyz: Array) -> tuple[Array, Array]:
        """Return metres along and behind (n,) the plane of points (n, 3)."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        dx, dy = xyz[:, 0] - self.x, xyz[:, 1] - self.y
        return cos * dx + sin * dy, cos * dy - sin * dx


def write_elevations(folder: Path, path: Trajectory) -> list[dict[str, Any]]:
    """
    Write the elevations of a results folder's cloud; earlier ones are replaced.

    Returns
    -------
    list
        For each picture pair its `files` and `plane`, plain JSON values.

    """
    for old in folder.glob(PATTERN):
        old.unlink()
    facts: list[dict[str, Any]] = []
    for plane, rows in _facades(folder / PLY_NAME, path):
        number = len(facts) + 1
        grid = Grid(0.0, plane.length, -0.5, plane.top, PIXEL)
        along, behind = plane.coordinates(_xyz(rows))
        shown = (behind > -FRONT) & (behind < BACK) & (rows['classification'] != NOISE)
        along, behind, up = along[shown], behind[shown], rows['z'][shown]
        value = rows['intensity'][shown].astype(float)
        pictures = {'depth': _depth_picture(nearest_depth(along, up, behind, grid, GAP), plane)}
        if np.ptp(value) > 0.0:
            pictures['intensity'] = _intensity_picture(blended(along, up, value, grid, GAP),
                                                       plane)
        files = []
        for kind, picture in pictures.items():
            files.append(f'facade_elevation_{number}_{kind}.png')
            _write(folder / files[-1], picture, plane)
        facts.append({'files': files, 'plane': {
            'origin': [round(plane.x, 3), round(plane.y, 3)],
            'heading_deg': round(float(np.rad2deg(plane.heading)), 3),
            'length_m': round(plane.length, 2), 'grid_m': round(plane.grid[0], 3),
            'grid_is_period': plane.periodic}})
    return facts


def _facades(cloud: Path, path: Trajectory) -> Iterator[tuple[Plane, NDArray[np.void]]]:
    """Iterate over the planes along a path, each with the points around it."""
    for first, last in straight_pieces(path):
        begin, end = path.poses[first], path.poses[last]
        driven = end[:2] - begin[:2]
        length = float(np.hypot(*driven))
        heading = float(np.arctan2(driven[1], driven[0]))
        margin = max(REACH * (path.stamps_ns[last] - path.stamps_ns[first]) * 1e-9 / length, 2.0)
        rows = read_between(cloud, path.stamps_ns[first] * 1e-9 - margin,
                            path.stamps_ns[last] * 1e-9 + margin)
        if not len(rows):
            continue
        cos, sin = np.cos(heading), np.sin(heading)
        ahead = cos * (rows['x'] - begin[0]) + sin * (rows['y'] - begin[1])
        left = cos * (rows['y'] - begin[1]) - sin * (rows['x'] - begin[0])
        for side in (1.0, -1.0):
            own = (side * left > 0.5) & (ahead > 0.0) & (ahead < length)
            if np.count_nonzero(own & (rows['classification'] == FACADE)) >= ENOUGH:
                yield _plane(rows[own], begin, heading, side, length), rows[own]


def straight_pieces(path: Trajectory) -> list[tuple[int, int]]:
    """Return the first and last pose of each piece of a path that is straight and long enough."""
    steps = np.hypot(*np.diff(path.poses[:, :2], axis=0).T)
    driven = np.concatenate([[0.0], np.cumsum(steps)])
    course = path.poses[:, 2]
    pieces, first = [], 0
    for i in range(1, len(path)):
        last = i == len(path) - 1
        if last or abs(course[i] - course[first]) > BEND or driven[i] - driven[first] > LONGEST:
            if np.hypot(*(path.poses[i] - path.poses[first])[:2]) > SHORTEST:
                pieces.append((first, i))
            first = i
    return pieces


def _xyz(rows: NDArray[np.void]) -> Array:
    return np.column_stack([rows['x'], rows['y'], rows['z']])


def _plane(rows: NDArray[np.void], begin: Array, heading: float, side: float,
           length: float) -> Plane:
    """Fit the vertical plane that most facade points of one side of the street are near."""
    walls = rows[rows['classification'] == FACADE]
    cos, sin = np.cos(heading), np.sin(heading)
    along = cos * (walls['x'] - begin[0]) + sin * (walls['y'] - begin[1])
    away = side * (cos * (walls['y'] - begin[1]) - sin * (walls['x'] - begin[0]))
    count, edges = np.histogram(away, bins=np.arange(0.0, 40.0, 0.25))
    offset, slope = float(edges[np.argmax(count)] + 0.125), 0.0
    for width in (1.0, 0.5, 0.2, 0.1):
        near = np.abs(away - offset - slope * along) < width
        if np.count_nonzero(near) > 100:
            slope, offset = np.polyfit(along[near], away[near], 1)
    # seen from the street, right is ahead on the left side, and back on the right side
    direction = heading + side * np.arctan(slope) + (0.0 if side > 0.0 else np.pi)
    start = 0.0 if side > 0.0 else length
    at = offset + slope * start
    x = begin[0] + cos * start - side * sin * at
    y = begin[1] + sin * start + side * cos * at
    top = float(np.percentile(walls['z'], 99.8)) + 0.5
    plane = Plane(float(x), float(y), float(direction), length, top, (SPACING, 0.0), False)
    own_along, behind = plane.coordinates(_xyz(walls))
    grid = column_grid(own_along, behind, walls['z'])
    return plane if grid is None else Plane(
        plane.x, plane.y, plane.heading, length, top, grid, True)


def column_grid(along: Array, behind: Array, up: Array) -> tuple[float, float] | None:
    """
    Return spacing and start of the grid that what stands before a plane repeats in.

    The depth of the nearest surface, 1 to 6 m high, is compared with itself shifted; None where
    no shift of 2.5 to 12 m makes it agree.
    """
    low = (up > 1.0) & (up < 6.0) & (np.abs(behind) < FRONT)
    cells = np.floor(along[low] / 0.1).astype(int)
    if not len(cells) or cells.max() - cells.min() < 40.0 / 0.1:
        return None
    cells, first = cells - cells.min(), cells.min()
    profile = np.full(cells.max() + 1, np.nan)
    order = np.argsort(-behind[low], kind='stable')
    profile[cells[order]] = behind[low][order]
    known = np.isfinite(profile)
    centred = np.where(known, profile - np.nanmean(profile), 0.0)
    shifts = np.arange(int(PERIODS[0] / 0.1), int(PERIODS[1] / 0.1) + 1)
    match = np.array([np.sum(centred[k:] * centred[:-k]) / np.sqrt(
        np.sum(centred[k:]**2) * np.sum(centred[:-k]**2) + 1e-12) for k in shifts])
    if match.max() < 0.5:
        return None
    # the shortest shift that agrees about as well as the best, refined by a parabola
    peaks = [i for i in range(1, len(match) - 1) if match[i] > 0.85 * match.max()
             and match[i] >= match[i - 1] and match[i] >= match[i + 1]]
    if not peaks:
        return None
    i = peaks[0]
    bend = match[i - 1] - 2.0 * match[i] + match[i + 1]
    period = 0.1 * (shifts[i] + (0.5 * (match[i - 1] - match[i + 1]) / bend if bend else 0.0))
    # the phase at which the nearest surfaces lie
    place = 0.1 * (first + 0.5 + np.arange(len(profile)))
    phase = np.angle(np.sum(-centred * np.exp(2j * np.pi * place / period)))
    return float(period), float(phase / (2.0 * np.pi) * period % period)


def _depth_picture(depth: Array, plane: Plane) -> NDArray[np.uint8]:
    """Return depth (rows, columns), metres behind the plane, in colours, top row first."""
    from matplotlib import colormaps

    known = depth[np.isfinite(depth)]
    near, far = np.percentile(known, [1.0, 99.0]) if len(known) else (0.0, 1.0)
    scaled = (far - depth) / max(far - near, 0.2)
    colours = colormaps['viridis'](np.clip(np.nan_to_num(scaled), 0.0, 1.0))[:, :, :3]
    colours[~np.isfinite(depth)] = 1.0
    return _with_grid(colours, plane)


def _intensity_picture(value: Array, plane: Plane) -> NDArray[np.uint8]:
    known = value[np.isfinite(value)]
    low, high = np.percentile(known, [2.0, 98.0]) if len(known) else (0.0, 1.0)
    grey = np.clip((np.nan_to_num(value) - low) / max(high - low, 1e-6), 0.0, 1.0)
    grey = np.where(np.isfinite(value), grey, 1.0)
    return _with_grid(np.repeat(grey[:, :, None], 3, axis=2), plane)


def _with_grid(colours: Array, plane: Plane) -> NDArray[np.uint8]:
    """Draw the grid's lines half through, turn the picture upright and into bytes."""
    spacing, start = plane.grid
    for along in np.arange(start, plane.length, spacing):
        column = min(int(along / PIXEL), colours.shape[1] - 1)
        colours[:, column] = 0.5 * colours[:, column] + 0.5 * np.array([0.85, 0.1, 0.1])
    return np.asarray(np.rint(255.0 * colours[::-1]), dtype=np.uint8)


def _write(path: Path, picture: NDArray[np.uint8], plane: Plane) -> None:
    """Write a picture with its world file."""
    info = PngInfo()
    info.add_text('Description', f'{PIXEL} m a pixel; grid every {plane.grid[0]:.2f} m; origin '
                  f'({plane.x:.3f}, {plane.y:.3f}) in odom, heading {plane.heading:.6f} rad')
    Image.fromarray(picture).save(path, pnginfo=info)
    top = -0.5 + PIXEL * (picture.shape[0] - 0.5)
    path.with_suffix('.pgw').write_text(
        '\n'.join(f'{v:.6f}' for v in (PIXEL, 0.0, 0.0, -PIXEL, 0.5 * PIXEL, top)) + '\n',
        encoding='ascii')
