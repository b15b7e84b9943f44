# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the motion: path, velocity, range image."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
import numpy as np
from numpy.typing import NDArray

from stri_mapping.report.data import RangeImageData, ReportData
from stri_mapping.stri.range_image import coloured

Array = NDArray[np.float64]

WIDTH = 10.0                                     # inches, the page's width
INK, BLUE, LIGHT_BLUE, RED = '#24292f', '#0b5cad', '#9ec5ee', '#c0392b'
# Points of a curve drawn at most: more cannot be told apart on a page.
CURVE_POINTS = 1500
PATH_POINTS = 600
# Percent of the points, on either side, that are let out as stray returns.
OUTLIERS = 0.3


def style(axes: Axes, xlabel: str = '', ylabel: str = '') -> None:
    """Give axes the look of the report."""
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.spines[['top', 'right']].set_visible(False)
    axes.spines[['left', 'bottom']].set_color('#8c959f')
    axes.tick_params(colors=INK, labelcolor=INK, length=3)
    axes.grid(color='#d8dee4', linewidth=0.6)
    axes.set_axisbelow(True)


def colour_bar(figure: Figure, axes: Axes | list[Axes], shown: AxesImage | LineCollection,
               label: str) -> None:
    """Add a slim colour bar beside axes."""
    bar = figure.colorbar(shown, ax=axes, label=label, fraction=0.025, pad=0.015, aspect=25)
    bar.outline.set_visible(False)


def path_figure(data: ReportData) -> Figure:
    """Draw the path from above, coloured by speed, over what stands beside it."""
    assert data.path is not None
    shown = np.linspace(0, len(data.path) - 1, min(len(data.path), PATH_POINTS)).astype(int)
    xy = data.path.poses[shown, :2]
    walls = data.walls
    seen = xy if walls is None else np.concatenate([xy, walls])
    # a few far returns through gaps must not shrink the street
    low, high = np.percentile(seen, [OUTLIERS, 100.0 - OUTLIERS], axis=0)
    low, high = np.minimum(low, xy.min(axis=0)) - 2.0, np.maximum(high, xy.max(axis=0)) + 2.0
    height = np.clip((WIDTH - 1.6) * (high[1] - low[1]) / (high[0] - low[0]) + 0.6, 1.3, 7.5)
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    axes = figure.subplots()
    if walls is not None:
        _draw_density(axes, walls, low, high)
    speed = _speed_at(data, shown)
    line = LineCollection(list(np.stack([xy[:-1], xy[1:]], axis=1)), cmap='plasma', linewidths=2.5,
                          array=0.5 * (speed[1:] + speed[:-1]), capstyle='round', zorder=3)
    axes.add_collection(line)
    axes.plot(*xy[0], 'o', color='white', markeredgecolor=INK, markersize=6, zorder=4)
    axes.annotate('start', xy[0], (4, -11), textcoords='offset points', color=INK)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect='equal')
    style(axes, 'x in m', 'y in m')
    colour_bar(figure, axes, line, 'm/s')
    return figure


def _draw_density(axes: Axes, points: Array, low: Array, high: Array) -> None:
    """Shade where points (n, 2) lie above each other: walls come out dark."""
    cell = max(float(np.max(high - low)) / 1400.0, 0.02)
    bins = [np.arange(a, b + cell, cell) for a, b in zip(low, high)]
    count, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=bins)
    shade = np.where(count > 0.0, np.log1p(count), np.nan).T
    axes.imshow(shade, cmap='Greys', vmin=-1.5, origin='lower',
                extent=(bins[0][0], bins[0][-1], bins[1][0], bins[1][-1]), interpolation='none')


def _speed_at(data: ReportData, poses: NDArray[np.intp]) -> Array:
    """Return the speed at some poses of the path, by index; 0 where nothing is known of it."""
    assert data.path is not None
    if len(data.seconds) < 2:
        return np.zeros(len(poses))
    moments = (data.path.stamps_ns[poses] - data.path.stamps_ns[0]) * 1e-9
    speed = np.hypot(data.velocity[:, 0], data.velocity[:, 1])
    return np.asarray(np.interp(moments, data.seconds, speed))


def velocity_figure(data: ReportData) -> Figure:
    """Draw forward speed, yaw rate and quality over time, with two standard deviations."""
    figure = Figure(figsize=(WIDTH, 5.6), layout='constrained')
    rows = figure.subplots(3, 1, sharex=True, height_ratios=[3.0, 1.6, 1.0])
    step = -(-len(data.seconds) // CURVE_POINTS)
    t, v = data.seconds[::step], data.velocity[::step]
    _draw_band(rows[0], t, v[:, 0], v[:, 3])
    _draw_band(rows[1], t, np.rad2deg(v[:, 2]), np.rad2deg(v[:, 5]))
    rows[2].fill_between(t, v[:, 6], color=LIGHT_BLUE, linewidth=0.0)
    rows[2].set_ylim(0.0, 1.05)
    for number, axes in enumerate(rows):
        for start, stop in data.degenerate:
            if stop - start < (t[-1] - t[0]) / CURVE_POINTS:
                continue                     # narrower than a line
            axes.axvspan(start, stop, color=RED, alpha=0.14, linewidth=0.0,
                         label='not observable' if number == 0 else None)
        axes.margins(x=0.0)
    style(rows[0], '', 'forward speed in m/s')
    style(rows[1], '', 'yaw rate in deg/s')
    style(rows[2], 'time in s', 'quality')
    handles, labels = rows[0].get_legend_handles_labels()
    unique = dict(zip(labels, handles))
    rows[0].legend(unique.values(), unique.keys(), loc='upper right', frameon=False, ncols=3)
    return figure


def _draw_band(axes: Axes, t: Array, value: Array, sigma: Array) -> None:
    axes.fill_between(t, value - 2.0 * sigma, value + 2.0 * sigma, color=LIGHT_BLUE,
                      alpha=0.7, linewidth=0.0, label='two standard deviations')
    axes.plot(t, value, color=BLUE, linewidth=1.2, label='estimate')
    # where nothing is known the band may be boundless: keep the curve readable
    band = np.concatenate([value - 2 * sigma, value + 2 * sigma, value])
    low, high = np.percentile(band[np.isfinite(band)], [2, 98])
    low, high = min(low, value.min()), max(high, value.max())
    margin = 0.08 * max(high - low, 0.05)
    axes.set_ylim(low - margin, high + margin)


def range_image_figure(image: RangeImageData) -> Figure:
    """Draw the range image with time to the right, and the surfaces found in it."""
    figure = Figure(figsize=(WIDTH, 5.4), layout='constrained')
    rows = figure.subplots(2, 1, sharex=True, sharey=True)
    bearings = np.rad2deg(image.bearings)
    extent = (float(image.seconds[0]), float(image.seconds[-1]), float(bearings[0]),
              float(bearings[-1]))
    columns = _even_columns(image.seconds)
    ranges = np.where(np.isfinite(image.ranges), image.ranges, np.nan)[columns].T
    far = float(np.nanpercentile(ranges, 90)) if np.any(np.isfinite(ranges)) else 1.0
    shown = rows[0].imshow(ranges, cmap='viridis_r', vmin=0.0, vmax=far, origin='lower',
                           extent=extent, aspect='auto', interpolation='none')
    segments = coloured(image.segments[columns].T)
    segments[image.segments[columns].T < 0] = 255
    rows[1].imshow(segments, origin='lower', extent=extent, aspect='auto', interpolation='none')
    for axes, name in zip(rows, ('range', 'surfaces')):
        axes.set_title(name, loc='left', fontsize='medium', color=INK)
        style(axes, '' if axes is rows[0] else 'time in s', 'bearing in deg')
        axes.grid(False)
    colour_bar(figure, list(rows), shown, 'range in m')
    return figure


def _even_columns(seconds: Array) -> NDArray[np.intp]:
    """Return the rows of the log to show at evenly spaced times."""
    even = np.linspace(seconds[0], seconds[-1], min(len(seconds), CURVE_POINTS))
    return np.clip(np.searchsorted(seconds, even), 0, len(seconds) - 1)
