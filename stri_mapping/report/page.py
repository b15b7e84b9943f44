# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""report.html: headline figures, pictures and tables on one page without outside parts."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from io import BytesIO
import os
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
import numpy as np

from stri_mapping.report.data import read_folder, ReportData
from stri_mapping.report.facade_figures import comparison_figure, elevation_figure, facade_views
from stri_mapping.report.figures import path_figure, range_image_figure, velocity_figure
from stri_mapping.results import REPORT_NAME

# Fixed, so that the same folder gives the same bytes.
LOOK: Any = {'font.size': 9, 'font.family': 'DejaVu Sans', 'svg.hashsalt': 'stri_mapping',
        'text.color': '#24292f', 'axes.labelcolor': '#24292f', 'legend.fontsize': 8.5}
IMAGE_DPI = 150


def write_report(folder: Path) -> Path:
    """
    Write report.html from the other files of a results folder; what is missing is left out.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    StriMappingError
        If a file of the folder cannot be understood.

    """
    with matplotlib.rc_context(LOOK):
        page = _page(read_folder(folder))
    part = folder / (REPORT_NAME + '.part')
    part.write_text(page, encoding='utf-8')
    os.replace(part, folder / REPORT_NAME)
    return folder / REPORT_NAME


def _page(data: ReportData) -> str:
    source = Path(str(data.summary.get('source', ''))).name
    title = f'Street map of {source}' if source else 'Street map'
    parts = [f'<h1>{escape(title)}</h1>', _cards(data.summary), _warnings(data.summary),
             _path(data), *_facades(data), *_motion(data), _quality(data), _footer(data.summary)]
    return PAGE.replace('$TITLE', escape(title)).replace('$BODY', '\n'.join(filter(None, parts)))


def _cards(summary: Mapping[str, Any]) -> str:
    """Return the headline figures there are."""
    cards = [
        ('distance', 'distance_m', '{:.1f} m'), ('duration', 'duration_s', '{:.1f} s'),
        ('mean speed', 'mean_speed_mps', '{:.2f} m/s'),
        ('top speed', 'max_speed_mps', '{:.2f} m/s'), ('facade points', 'points', '{:,}'),
        ('times real time', 'real_time_factor', '{:.1f}'),
        ('time per scan', 'ms_per_scan', '{:.2f} ms'),
        ('not observable', 'degenerate_s', '{:.1f} s'), ('lost scans', 'lost_scans', '{:,}')]
    shown = [(name, form.format(summary[key])) for name, key, form in cards if key in summary]
    return '<dl class="cards">' + ''.join(
        f'<div><dt>{name}</dt><dd>{value}</dd></div>' for name, value in shown) + '</dl>'


def _warnings(summary: Mapping[str, Any]) -> str:
    warnings = summary.get('warnings', [])
    if not warnings:
        return ''
    items = ''.join(f'<li>{escape(str(w))}</li>' for w in warnings)
    return f'<section class="warnings"><h2>To be aware of</h2><ul>{items}</ul></section>'


def _path(data: ReportData) -> str:
    if data.path is None:
        return ''
    walls = '' if data.walls is None else ', with what was seen beside it'
    return _section('Path', f'The drive from above, coloured by speed{walls}.',
                    [('path from above', path_figure(data))])


def _motion(data: ReportData) -> Iterable[str]:
    """Yield the sections on velocity and range image."""
    if len(data.seconds) > 1:
        yield _section(
            'Velocity', 'Motion of the vehicle from the horizontal scanner alone, with the band '
            'of two standard deviations. Quality is the share of the motion that the scans tell.',
            [('velocity over time', velocity_figure(data))])
    if data.range_image is not None:
        yield _section(
            'Range image', 'Scans of the horizontal scanner stacked along time. What stands '
            'still draws curves of one shape, and their slope is the motion. Below, the surfaces '
            'told apart, one colour each.',
            [('range image and surfaces', range_image_figure(data.range_image))])


def _facades(data: ReportData) -> Iterable[str]:
    """Yield the sections on the facades."""
    if data.cloud is None or data.path is None:
        return
    views = facade_views(data.cloud, data.path)
    for view in views:
        side = 'left' if view.left else 'right'
        figures = [(f'{side} facade by depth', elevation_figure(view))]
        if np.ptp(view.points.value) > 0.0:
            figures.append((f'{side} facade by intensity', elevation_figure(view, 'intensity')))
        yield _section(f'Facade on the {side}', 'As seen from the street, unrolled along the '
                       'path. Depth is the distance from the path.', figures)
    if data.cloud.before is not None and views:
        yield _section(
            'Before and after alignment', 'The piece of the street that suffers most when a '
            'straight drive at the mean speed is assumed, and the same scan lines put where '
            'the vehicle was: elevation above, plan below.',
            [('before and after', comparison_figure(data.cloud, data.path, views[0]))])


def _quality(data: ReportData) -> str:
    """Return the tables: scanners, and errors against the truth where evaluated."""
    columns = [('scanner', 'name'), ('role', 'role'), ('topic', 'topic'), ('scans', 'scans'),
               ('lost', 'lost_scans'), ('malformed', 'malformed_scans'),
               ('backwards', 'backwards_scans'), ('empty', 'scans_without_return')]
    rows = [[str(s.get(key, '')) for _, key in columns] for s in data.summary.get('scanners', [])]
    html = '<h2>Quality</h2>' + _table([name for name, _ in columns], rows) if rows else ''
    html += _cloud_quality(data.summary.get('facade_quality', {}))
    metrics = data.evaluation.get('metrics', [])
    if metrics:
        html += f'<h2>Errors against {escape(Path(str(data.evaluation["truth"])).name)}</h2>'
        html += _table(['error', 'value', 'unit'], [
            [m['text'], '–' if m['value'] is None else f'{m["value"]:.4g}', m['unit']]
            for m in metrics])
    return f'<section>{html}</section>' if html else ''


def _cloud_quality(stages: Mapping[str, Mapping[str, float | None]]) -> str:
    """Return the table of what the cloud tells of itself before and after each stage."""
    if not stages:
        return ''
    names = {'at_constant_speed': 'straight at the mean speed', 'aligned': 'aligned, planar',
             'stabilised': 'stabilised'}
    columns = [('surfaces compared', 'cubes', '{:.0f}'),
               ('thickness, mm', 'thickness_mm', '{:.1f}'),
               ('scanners differ by, mm', 'agreement_mm', '{:.1f}'),
               ('doubled', 'doubled', '{:.1%}'), ('walls lean, deg', 'lean_deg', '{:.2f}')]
    rows = [[names.get(stage, stage), *('–' if figures[key] is None else form.format(figures[key])
                                        for _, key, form in columns)]
            for stage, figures in stages.items()]
    return '<h2>The cloud, told by itself</h2>' + _table(
        ['', *(name for name, _, _ in columns)], rows)


def _footer(summary: Mapping[str, Any]) -> str:
    version = escape(str(summary.get('version', '')))
    return (f'<footer>stri_mapping {version}. Motion by the spatio-temporal range image of Ono '
            'and Ikeuchi; times in seconds since the first pose, coordinates in odom.</footer>')


def _section(title: str, text: str, figures: Sequence[tuple[str, Figure]]) -> str:
    pictures = ''.join(f'<div class="picture"><img alt="{name}" src="{_embedded(figure)}"></div>'
                       for name, figure in figures)
    return f'<section><h2>{title}</h2><p>{text}</p>{pictures}</section>'


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = ''.join(f'<th>{escape(name)}</th>' for name in header)
    body = ''.join('<tr>' + ''.join(f'<td>{escape(v)}</td>' for v in row) + '</tr>'
                   for row in rows)
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'


def _embedded(figure: Figure) -> str:
    """Return a figure as a data URI: an SVG whose images are kept in their own pixels."""
    file = BytesIO()
    figure.savefig(file, format='svg', dpi=IMAGE_DPI, metadata={'Date': None})
    return 'data:image/svg+xml;base64,' + base64.b64encode(file.getvalue()).decode('ascii')


PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$TITLE</title>
<style>
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif;
  color: #24292f; background: #fff; max-width: 1080px; margin: 0 auto; padding: 1.5rem 1rem; }
h1 { font-size: 1.9rem; font-weight: 650; margin: 0 0 1rem; overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .3rem; }
p { margin: 0 0 .8rem; color: #57606a; max-width: 46rem; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.6rem, 1fr));
  gap: .7rem; margin: 0; }
.cards div { background: #f3f6f9; border-radius: .6rem; padding: .7rem .9rem; }
.cards dt { color: #57606a; font-size: .82rem; }
.cards dd { margin: 0; font-size: 1.3rem; font-weight: 600; white-space: nowrap;
  font-variant-numeric: tabular-nums; }
.warnings { background: #fff8e5; border-left: 4px solid #d4a017; border-radius: .3rem;
  margin-top: 1.2rem; padding: .7rem 1rem; }
.warnings h2 { margin: 0; font-size: 1rem; }
.warnings ul { margin: .3rem 0 0; padding-left: 1.2rem; overflow-wrap: anywhere; }
.picture, .wide { overflow-x: auto; }
.picture img { display: block; width: 100%; min-width: 640px; margin-bottom: .8rem; }
table { border-collapse: collapse; font-size: .9rem; margin: .4rem 0 1rem; }
th, td { text-align: left; padding: .3rem .9rem .3rem 0; border-bottom: 1px solid #d8dee4;
  font-variant-numeric: tabular-nums; }
th { color: #57606a; font-weight: 500; }
footer { margin-top: 2.5rem; color: #57606a; font-size: .85rem; }
@media print { body { max-width: none; padding: 0; font-size: 11pt; }
  .picture img { min-width: 0; } .picture, .cards, .warnings, tr { break-inside: avoid; }
  h2 { break-after: avoid; }
  .cards div, .warnings { print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
</style>
</head>
<body>
$BODY
</body>
</html>
"""
