# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping run`: the live graph, every node a process, under one supervisor."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from datetime import datetime
from importlib.util import find_spec
import logging
from pathlib import Path
import tempfile
import time
from typing import Any, TYPE_CHECKING

from stri_mapping.commands.play import rate, require_ros
from stri_mapping.errors import BagError, EXIT_INTERRUPTED, StriMappingError, UsageError

if TYPE_CHECKING:
    from stri_mapping.bag_io import Bag
    from stri_mapping.graph import Products, Stages
    from stri_mapping.supervisor import Supervisor
    from stri_mapping.vehicle import Vehicle

logger = logging.getLogger(__name__)


def add_parser(subparsers: Any) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        'run', help='run the live nodes',
        description='Start drivers (or the player of a bag, or a virtual vehicle), estimator and '
        'aligner as processes, keep them running, and end them in order at Ctrl-C or when bag '
        'or virtual drive are over. The results folder is that of "map".')
    source = parser.add_mutually_exclusive_group()
    source.add_argument('--bag', type=Path, metavar='BAG',
                        help='play this bag through the nodes, instead of driving')
    source.add_argument('--simulate', metavar='SCENE',
                        help='drive a virtual vehicle through this scene, its scanners at '
                        'serial ports as real ones are ("stri-mapping simulate list")')
    parser.add_argument('--rate', type=rate, metavar='R',
                        help='with --bag: speed over that of recording; 0 for as fast as the '
                        'nodes take it (1)')
    parser.add_argument('--seed', type=int, metavar='N',
                        help='with --simulate: draws everything random (1)')
    parser.add_argument('--duration', type=float, metavar='S',
                        help="with --simulate: seconds; the scene's own by default")
    parser.add_argument('--record', type=Path, metavar='DIR',
                        help='record into this new bag, or into a new one in this directory')
    parser.add_argument('--view', action='store_true',
                        help='serve all topics at ws://127.0.0.1:8765 for Foxglove')
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
        0 when all went well, which on the vehicle Ctrl-C is part of; 130 when a bag or a virtual
        drive was interrupted; else the exit code of the node that failed.  The results folder
        holds what was computed in each case.

    """
    from stri_mapping.commands.map import kept_messages
    from stri_mapping.graph import Products
    from stri_mapping.results import prepare_folder
    from stri_mapping.supervisor import Supervisor
    from stri_mapping.vehicle import default_vehicle_file, load_vehicle, write_vehicle

    require_ros()
    _check(args)
    now = f'{datetime.now():%Y-%m-%d-%H%M%S}'
    products = Products(args.output or Path('out') / f'run-{now}', _recording(args.record, now),
                        args.view)
    with kept_messages() as messages, ExitStack() as held:
        vehicle, stages = _graph(
            args, load_vehicle(args.vehicle or default_vehicle_file()), products, held)
        prepare_folder(products.folder, args.overwrite)
        write_vehicle(products.folder / 'vehicle.yaml', vehicle)
        began = time.perf_counter()
        with Supervisor(products.folder, stages) as graph:
            code = _supervise(graph, products.folder)
    early = graph.interrupted and (args.bag or args.simulate)
    ended = 'interrupted' if early else graph.failure
    _complete(products.folder, time.perf_counter() - began, {
        'source': str(args.bag or args.simulate or 'scanners'),
        'complete': ended is None and not graph.remarks,
        'messages': messages + graph.remarks + ([ended] if ended else [])})
    return EXIT_INTERRUPTED if early and code == 0 else code


def _check(args: argparse.Namespace) -> None:
    """Refuse options that have no effect on what was asked."""
    for name, needs in (('rate', 'bag'), ('seed', 'simulate'), ('duration', 'simulate')):
        if getattr(args, name) is not None and getattr(args, needs) is None:
            raise UsageError(f'--{name} goes with --{needs} only')
    if args.view and find_spec('foxglove') is None:
        raise UsageError("--view needs foxglove-sdk: pip install 'stri_mapping[viewer]'")


def _recording(path: Path | None, now: str) -> Path | None:
    """Return the bag to record: the path, or one in it that is named by the date."""
    if path is None or not path.exists():
        return path
    if not path.is_dir() or any(path.glob('*.mcap')) or (path / 'metadata.yaml').exists():
        raise BagError(f'{path}: exists already; name a new directory')
    return path / f'drive-{now}'


def _graph(args: argparse.Namespace, vehicle: Vehicle, products: Products, held: ExitStack,
           ) -> tuple[Vehicle, Stages]:
    """Return the vehicle as it is met, and the nodes; what they need is held meanwhile."""
    from stri_mapping import graph
    from stri_mapping.bag_io import Bag, select_scanners

    if args.bag:
        with Bag(args.bag) as bag:
            vehicle = select_scanners(bag, vehicle)
            topics = inputs(bag, vehicle)
        speed = 1.0 if args.rate is None else args.rate
        return vehicle, graph.bag_graph(vehicle, products, args.bag, speed, topics)
    if args.simulate:
        ports = held.enter_context(tempfile.TemporaryDirectory(prefix='stri-mapping-'))
        return vehicle, graph.virtual_graph(vehicle, products, Path(ports), _scene(args))
    return vehicle, graph.hardware_graph(vehicle, products)


def _scene(args: argparse.Namespace) -> dict[str, Any]:
    """Return what the virtual vehicle is told, having made sure that it can be."""
    try:
        from stri_mapping.simulation.scenes import SCENES
    except ImportError as error:
        raise UsageError(f'the package "{error.name}" is missing: '
                         "pip install 'stri_mapping[simulation]'") from None
    if args.simulate not in SCENES:
        raise UsageError(f'--simulate {args.simulate}: want one of {", ".join(SCENES)}')
    if args.duration is not None and not 0.0 < args.duration < float('inf'):
        raise UsageError(f'--duration is {args.duration:g}: want more than 0 s')
    return {'scene': args.simulate, 'seed': 1 if args.seed is None else args.seed,
            'duration': args.duration or 0.0}


def inputs(bag: Bag, vehicle: Vehicle) -> list[str]:
    """Return the topics to play: not what nodes like these published when it was recorded."""
    return [*(s.topic for s in vehicle.scanners),
            *(t for t in sorted(bag.topics) if t == '/tf_static' or t.startswith('/ground_truth'))]


def _supervise(graph: Supervisor, folder: Path) -> int:
    """Run the graph with its state on the screen; return its exit code."""
    from rich.console import Console

    from stri_mapping.nodes.monitor import GraphMonitor
    from stri_mapping.status import StatusBoard

    with GraphMonitor() as monitor, StatusBoard(Console(), folder) as board:
        return graph.run(lambda children: board.show(children, monitor.statuses), monitor.ready)


def _complete(folder: Path, wall: float, facts: dict[str, Any]) -> None:
    """Write summary and report of what the nodes left, and say where; hide no node's fault."""
    from rich.console import Console

    from stri_mapping.commands.map import print_summary
    from stri_mapping.disk import keeping
    from stri_mapping.facade.finish import finish_facades
    from stri_mapping.report import write_report
    from stri_mapping.summary import read_summary, write_summary

    recorded = float(read_summary(folder).get('duration_s', 0.0))
    try:
        with keeping(folder):
            facts = {**facts, **finish_facades(folder)}
    except StriMappingError as error:
        logger.warning('no facade pictures: %s', error)
    summary = write_summary(folder, {**facts, 'wall_s': round(wall, 3),
                                     'real_time_factor': round(recorded / wall, 2)})
    try:
        with keeping(folder, room=0):
            write_report(folder)
    except StriMappingError as error:
        logger.warning('no report: %s', error)
    if 'ms_per_scan' in summary:            # the estimator came to its end
        print_summary(summary, folder, Console())
