# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping evaluate`: errors of a results folder against the truth."""

from __future__ import annotations

import argparse
from dataclasses import asdict
import json
from pathlib import Path
from typing import Any, TYPE_CHECKING

from stri_mapping.errors import TrajectoryError, UsageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console

    from stri_mapping.metrics import Metric
    from stri_mapping.trajectory import Trajectory

TRUTH_TOPIC = '/ground_truth/odom'


def add_parser(subparsers: Any) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        'evaluate', help='compare results with the truth',
        description='Print the errors of a results folder and write them to evaluation.json '
        'there.')
    parser.add_argument('folder', type=Path, metavar='DIR', help='results folder')
    parser.add_argument('--truth', type=Path, required=True, metavar='FILE',
                        help='TUM file of base_link, relations.csv of the laser '
                        '(t1,t2,dx,dy,dyaw), or a bag with odometry')
    parser.add_argument('--topic', default=TRUTH_TOPIC,
                        help='odometry in the bag (default: %(default)s)')
    parser.add_argument('--window', type=float, default=0.2, metavar='S',
                        help='seconds over which speeds are compared (default: %(default)s)')
    parser.add_argument('--mount', type=float, nargs=3, metavar=('X', 'Y', 'YAW'),
                        help='horizontal scanner in base_link, metres and radians: the point '
                        'whose speed is judged (default: as summary.json says)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """
    Evaluate, print and write.

    Raises
    ------
    StriMappingError
        If results or truth cannot be read, or have no time in common.

    """
    from rich.console import Console

    from stri_mapping.report import write_report
    from stri_mapping.results import EVALUATION_NAME, REPORT_NAME, TRAJECTORY_NAME
    from stri_mapping.trajectory import read_tum

    if not args.window > 0.0:
        raise UsageError(f'--window is {args.window:g}: want more than 0 s')
    if not args.folder.is_dir():
        raise TrajectoryError(f'{args.folder}: no such results folder')
    estimate = read_tum(args.folder / TRAJECTORY_NAME)
    metrics = _metrics(estimate, args, _mount(args))
    _print(metrics, args, Console())
    content = {'truth': str(args.truth), 'window_s': args.window,
               'errors': {m.name: m.value for m in metrics},
               'metrics': [asdict(m) for m in metrics]}
    (args.folder / EVALUATION_NAME).write_text(json.dumps(content, indent=2) + '\n',
                                               encoding='utf-8')
    if (args.folder / REPORT_NAME).is_file():
        write_report(args.folder)
    return 0


def _mount(args: argparse.Namespace) -> NDArray[np.float64]:
    """Return the planar mount (3,) of the horizontal scanner."""
    import numpy as np

    from stri_mapping import geometry
    from stri_mapping.summary import read_summary
    from stri_mapping.vehicle import Scanner

    if args.mount:
        return np.array(args.mount)
    for entry in read_summary(args.folder).get('scanners', []):
        if entry['role'] == 'horizontal':
            T = geometry.transform(entry['mount']['xyz'], entry['mount']['rpy'])
            return Scanner(entry['name'], 'horizontal', T, '', '').planar_mount
    raise UsageError(f'{args.folder}/summary.json does not tell where the horizontal scanner '
                     'sits; give it with --mount X Y YAW')


def _metrics(
    estimate: Trajectory, args: argparse.Namespace, mount: NDArray[np.float64],
) -> list[Metric]:
    from stri_mapping.metrics import path_metrics, speed_metrics, twist_metrics
    from stri_mapping.motion_file import read_velocity
    from stri_mapping.relations import read_relations, relation_metrics
    from stri_mapping.results import VELOCITY_NAME

    if args.truth.suffix == '.csv':
        return relation_metrics(estimate, read_relations(args.truth), mount)
    truth = _read_truth(args.truth, args.topic)
    metrics = [*path_metrics(estimate, truth),
               *speed_metrics(estimate, truth, args.window, mount[:2])]
    if (args.folder / VELOCITY_NAME).is_file():
        stamps, values = read_velocity(args.folder / VELOCITY_NAME)
        metrics += twist_metrics(stamps, values, truth, args.window)
    return metrics


def _read_truth(path: Path, topic: str) -> Trajectory:
    """Return the true poses of base_link from a bag or a TUM file."""
    from stri_mapping.bag_io import Bag
    from stri_mapping.trajectory import read_tum

    if not path.exists():
        raise TrajectoryError(f'{path}: no such file or directory')
    if path.is_dir() or path.suffix in ('.mcap', '.bag', '.db3'):
        with Bag(path) as bag:
            return bag.odometry(topic)
    return read_tum(path)


def _print(metrics: list[Metric], args: argparse.Namespace, console: Console) -> None:
    from rich.table import Table

    table = Table(title=f'{args.folder} against {args.truth}', title_justify='left')
    table.add_column('error')
    table.add_column('value', justify='right')
    table.add_column('unit')
    for metric in metrics:
        value = '-' if metric.value is None else f'{metric.value:.4g}'
        table.add_row(metric.text, value, metric.unit)
    console.print(table)
