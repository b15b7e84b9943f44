# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping run`: the live graph, every node a process, under one supervisor."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from datetime import datetime
import logging
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

from stri_mapping.commands.play import rate, require_ros
from stri_mapping.errors import EXIT_INTERRUPTED, StriMappingError

if TYPE_CHECKING:
    from stri_mapping.bag_io import Bag
    from stri_mapping.vehicle import Vehicle

logger = logging.getLogger(__name__)


def add_parser(subparsers: Any) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        'run', help='run the live nodes',
        description='Start player, estimator and aligner as processes, and end them in order '
        'when the bag is over or at Ctrl-C. The results folder is that of "map".')
    parser.add_argument('--bag', type=Path, required=True, metavar='BAG',
                        help='play this bag through the nodes')
    parser.add_argument('--rate', type=rate, default=1.0, metavar='R',
                        help='speed over that of recording; 0 for as fast as the nodes take it '
                        '(default: %(default)s)')
    parser.add_argument('--output', type=Path, metavar='DIR',
                        help='results folder (default: out/run-<date>)')
    parser.add_argument('--overwrite', action='store_true',
                        help='replace the results of an earlier run in DIR')
    parser.add_argument('--vehicle', type=Path, metavar='FILE',
                        help='vehicle description (default: the vehicle.yaml of the package)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """
    Run the graph and complete the results folder.

    Returns
    -------
    int
        0 when all went well, 130 after Ctrl-C, else the exit code of the node that failed.  The
        results folder holds what was computed in each case.

    """
    from stri_mapping.bag_io import Bag, select_scanners
    from stri_mapping.commands.map import kept_messages
    from stri_mapping.results import prepare_folder
    from stri_mapping.supervisor import Supervisor
    from stri_mapping.vehicle import default_vehicle_file, load_vehicle, write_vehicle

    require_ros()
    folder = args.output or Path('out') / f'run-{datetime.now():%Y-%m-%d-%H%M%S}'
    with kept_messages() as messages, Bag(args.bag) as bag:
        vehicle = select_scanners(bag, load_vehicle(args.vehicle or default_vehicle_file()))
        played = inputs(bag, vehicle)
    prepare_folder(folder, args.overwrite)
    write_vehicle(folder / 'vehicle.yaml', vehicle)
    began = time.perf_counter()
    with Supervisor(folder, node_parameters(args, folder, vehicle, played)) as graph:
        code = graph.run()
    ended = 'interrupted' if graph.interrupted else graph.failure
    _complete(folder, time.perf_counter() - began, {
        'source': str(args.bag), 'complete': ended is None,
        'messages': messages + ([ended] if ended else [])})
    return EXIT_INTERRUPTED if graph.interrupted and code == 0 else code


def inputs(bag: Bag, vehicle: Vehicle) -> list[str]:
    """Return the topics to play: not what nodes like these published when it was recorded."""
    return [*(s.topic for s in vehicle.scanners),
            *(t for t in sorted(bag.topics) if t == '/tf_static' or t.startswith('/ground_truth'))]


def node_parameters(
    args: argparse.Namespace, folder: Path, vehicle: Vehicle, played: Sequence[str],
) -> dict[str, dict[str, object]]:
    """Return the parameters of every node, from the graph's source to its end."""
    # no use_sim_time: the nodes take all times from the scans, and hundreds of messages a second
    # on /clock would cost each of them a fifth of a core
    common = {'vehicle_file': str((folder / 'vehicle.yaml').resolve()),
              'output': str(folder.resolve()), 'tf_static_wait': 0.0}
    player = {'bag': str(args.bag.resolve()), 'rate': args.rate, 'follow': 'odom',
              'topics': ' '.join(played),
              'subscribers': ' '.join(s.topic for s in vehicle.scanners)}
    nodes: dict[str, dict[str, object]] = {'bag_player': player, 'stri_estimator': common}
    if vehicle.verticals:
        nodes['facade_aligner'] = common
    return nodes


def _complete(folder: Path, wall: float, facts: dict[str, Any]) -> None:
    """Write summary and report of what the nodes left, and say where; hide no node's fault."""
    from rich.console import Console

    from stri_mapping.commands.map import print_summary
    from stri_mapping.report import write_report
    from stri_mapping.results import read_summary, write_summary

    recorded = float(read_summary(folder).get('duration_s', 0.0))
    summary = write_summary(folder, {**facts, 'wall_s': round(wall, 3),
                                     'real_time_factor': round(recorded / wall, 2)})
    try:
        write_report(folder)
    except StriMappingError as error:
        logger.warning('no report: %s', error)
    if 'ms_per_scan' in summary:            # the estimator came to its end
        print_summary(summary, folder, Console())
