# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the facades: elevation in strips, and a piece before and after alignment."""

from __future__ import annotations

from dataclasses import dataclass, replace

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.pictures import blended, Grid, nearest_depth, unroll, Unrolled
from stri_mapping.report.data import Cloud, GROUND
from stri_mapping.report.figures import colour_bar, INK, OUTLIERS, style, WIDTH
from stri_mapping.trajectory import constant_speed, Trajectory

Array = NDArray[np.float64]
Span = tuple[float, float]

# Behind the facades, where there is no point.
EMPTY = '#e6edf5'

# Metres of street in one strip of the elevation, at least, and strips at most.
STRIP, STRIPS = 60.0, 8
# Metres of street compared before and after alignment.
PIECE = 24.0
# Gaps between scan lines and rays up to about twice this many metres are closed in pictures: at
# 10 m neighbouring rays of a 1 degree scanner are 0.17 m apart.
REACH = 0.13


@dataclass(frozen=True, eq=False)
class FacadeView:
    """
    One side of the street, unrolled, with the scales that its pictures share.

    Attributes
    ----------
    points
        The points of that side.
    left
        Whether it is the left side.
    heights, depths
        What the pictures show, from and to, metres.

    """

    points: Unrolled
    left: bool
    heights: Span
    depths: Span

    @property
    def depth(self) -> Array:
        """Distance (n,) of the points from the path, metres."""
        return self.points.left if self.left else -self.points.left

    def draw_elevation(self, axes: Axes, along: Span, colour: str) -> AxesImage:
        """Draw the facade as seen from the street, nearest point in front."""
        grid = Grid(*along, *self.heights, (along[1] - along[0]) / 800.0)
        x, y, value = self.points.along, self.points.up, self.points.value
        if colour == 'depth':
            image, limits = nearest_depth(x, y, self.depth, grid, REACH), self.depths
        else:
            image = blended(x, y, value, grid, REACH)
            limits = (float(np.percentile(value, 2.0)), float(np.percentile(value, 98.0)))
        shown = axes.imshow(image, cmap='viridis_r' if colour == 'depth' else 'gray',
                            vmin=limits[0], vmax=limits[1], origin='lower', aspect='equal',
                            interpolation='none', extent=grid.extent)
        axes.set_facecolor(EMPTY)
        if not self.left:                # on the right side one gets on to the left
            axes.invert_xaxis()
        return shown

    def draw_plan(self, axes: Axes, along: Span) -> None:
        """Draw where points lie above each other, from above, without the ground."""
        walls = (self.points.up > self.heights[0] + GROUND) & (along[0] <= self.points.along) & (
            self.points.along < along[1])
        cell = (along[1] - along[0]) / 600.0
        depths = (self.depths[0] - 1.0, self.depths[1] + 1.0)
        bins = [np.arange(a, b + cell, cell) for a, b in (along, depths)]
        count, _, _ = np.histogram2d(self.points.along[walls], self.depth[walls], bins=bins)
        shade = np.where(count > 0.0, np.log1p(count), np.nan).T
        axes.imshow(shade, cmap='Blues', vmin=-1.0, origin='lower', interpolation='none',
                    extent=(*along, *depths), aspect='equal')
        if not self.left:
            axes.invert_xaxis()


def facade_views(cloud: Cloud, path: Trajectory) -> list[FacadeView]:
    """Return the sides of the street that hold at least a tenth of the points, fuller first."""
    points = unroll(cloud.xyz, cloud.intensity, path)
    left = points.left > 0.0
    views = [_facade_view(points.only(mask), side) for side, mask in ((True, left), (False, ~left))
             if np.count_nonzero(mask) > 0.1 * len(left)]
    return sorted(views, key=lambda view: -len(view.depth))


def _facade_view(points: Unrolled, left: bool) -> FacadeView:
    """Return the view of one side that shows nearly all of its points."""
    low, high = np.percentile(points.up, [OUTLIERS, 100.0 - OUTLIERS])
    depth = points.left if left else -points.left
    # the ground is at every depth; the walls tell the scale
    walls = depth[points.up > low + GROUND]
    near, far = np.percentile(walls if len(walls) else depth, [2.0, 98.0])
    return FacadeView(points, left, (float(low) - 0.3, float(high) + 0.3),
                      (float(near) - 0.2, float(far) + 0.2))


def elevation_figure(view: FacadeView, colour: str = 'depth') -> Figure:
    """Draw a whole facade in strips of equal length, coloured by depth or intensity."""
    low, high = np.percentile(view.points.along, [0.05, 99.95])
    count = int(np.clip(np.ceil((high - low) / STRIP), 1, STRIPS))
    length = max((high - low) / count, 10.0)
    height = (WIDTH - 1.4) * (view.heights[1] - view.heights[0]) / length
    figure = Figure(figsize=(WIDTH, min(count * (height + 0.35) + 0.5, 14.0)),
                    layout='constrained')
    strips = list(np.atleast_1d(figure.subplots(count, 1)))
    for number, axes in enumerate(strips):
        along = (low + number * length, low + (number + 1) * length)
        shown = view.draw_elevation(axes, along, colour)
        style(axes, 'metres along the street' if number == count - 1 else '', 'height in m')
        axes.grid(False)
    colour_bar(figure, strips, shown,
               'intensity' if colour == 'intensity' else 'depth in m')
    return figure


def comparison_figure(cloud: Cloud, path: Trajectory, after: FacadeView) -> Figure:
    """Draw a piece of the street at constant mean speed beside the same as aligned."""
    straight = constant_speed(path)
    along = _worst_piece(path, straight)
    before = replace(after, points=_piece_before(cloud, straight, along, after.left))
    spans = [after.heights[1] - after.heights[0], after.depths[1] - after.depths[0] + 2.0]
    height = 0.5 * (WIDTH - 1.8) * sum(spans) / PIECE + 1.0
    figure = Figure(figsize=(WIDTH, min(height, 9.0)), layout='constrained')
    grid = figure.subplots(2, 2, sharex='col', height_ratios=spans)
    titles = ('before: straight at the mean speed', 'after: aligned')
    for column, (view, title) in enumerate(zip((before, after), titles)):
        shown = view.draw_elevation(grid[0, column], along, 'depth')
        view.draw_plan(grid[1, column], along)
        grid[0, column].set_title(title, loc='left', fontsize='medium', color=INK)
        style(grid[0, column], '', 'height in m' if column == 0 else '')
        style(grid[1, column], 'metres along the street',
              'depth in m' if column == 0 else '')
        grid[0, column].grid(False)
    colour_bar(figure, list(grid[0]), shown, 'depth in m')
    return figure


def _piece_before(cloud: Cloud, straight: Trajectory, along: Span, left: bool) -> Unrolled:
    """Return the points of one side and piece of the street as they lie before alignment."""
    assert cloud.before is not None
    x, y, yaw = straight.poses[0]
    ahead = (cloud.before[:, :2] - (x, y)) @ (np.cos(yaw), np.sin(yaw))
    near = (along[0] - 1.0 < ahead) & (ahead < along[1] + 1.0)
    points = unroll(cloud.before[near], cloud.intensity[near], straight)
    return points.only((points.left > 0.0) == left)


def _worst_piece(path: Trajectory, straight: Trajectory) -> Span:
    """Return the piece in which the true speed differs most from the mean."""
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.poses[:, :2], axis=0).T))])
    at_mean = np.hypot(*(straight.poses - straight.poses[0])[:, :2].T)
    worst = driven[np.argmax(np.abs(driven - at_mean))]
    start = float(np.clip(worst - 0.5 * PIECE, 0.0, max(driven[-1] - PIECE, 0.0)))
    return (start, start + PIECE)
