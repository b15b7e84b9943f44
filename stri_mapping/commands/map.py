# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping map`: a bag to a results folder, as fast as the machine allows."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import logging
from pathlib import Path
import signal
import threading
from types import FrameType
from typing import Any, TYPE_CHECKING

from stri_mapping.errors import StriMappingError

if TYPE_CHECKING:
    from rich.console import Console

    from stri_mapping.bag_io import Bag
    from stri_mapping.mapping import Mapper
    from stri_mapping.vehicle import Vehicle

# Scans between two updates of the progress bar, and messages kept for the report.
PROGRESS_STEP = 50
MESSAGES_KEPT = 20


def add_parser(subparsers: Any) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        'map', help='map a recorded drive',
        description='Read a bag and write trajectory.tum, velocity.csv, facade.laz, facade.ply, '
        'summary.json and report.html. One horizontal scanner alone gives no facade.')
    parser.add_argument('bag', type=Path, metavar='BAG',
                        help='rosbag2 directory, .mcap file or ROS 1 .bag file')
    parser.add_argument('--output', type=Path, required=True, metavar='DIR',
                        help='results folder; must be new or empty')
    parser.add_argument('--overwrite', action='store_true',
                        help='replace the results of an earlier run in DIR')
    parser.add_argument('--vehicle', type=Path, metavar='FILE',
                        help='vehicle description (default: the vehicle.yaml of the package)')
    parser.add_argument('--horizontal', metavar='TOPIC',
                        help='topic of the horizontal scanner (default: that of the vehicle)')
    parser.add_argument('--vertical', nargs='+', metavar='TOPIC',
                        help='topics of vertical scanners (default: those of the vehicle that '
                        'are in the bag)')
    parser.add_argument('--pcd', action='store_true', help='write facade.pcd too')
    parser.add_argument('--e57', action='store_true', help='write facade.e57 too')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """
    Map the bag.

    Returns
    -------
    int
        0 when the whole bag was mapped.

    Raises
    ------
    StriMappingError
        After writing what was computed, if the bag breaks off or gives no motion.
    KeyboardInterrupt
        After writing what was computed, if the user stopped it.

    """
    from rich.console import Console

    from stri_mapping.bag_io import Bag, select_scanners
    from stri_mapping.facade.export import export, FORMATS, require
    from stri_mapping.results import prepare_folder
    from stri_mapping.vehicle import default_vehicle_file, load_vehicle

    console = Console()
    wanted = [kind for kind in FORMATS if getattr(args, kind)]
    for kind in wanted:
        require(kind)
    vehicle = load_vehicle(args.vehicle or default_vehicle_file())
    with kept_messages() as messages, Bag(args.bag) as bag:
        vehicle = select_scanners(bag, vehicle, args.horizontal, args.vertical)
        prepare_folder(args.output, args.overwrite)
        try:
            failure = _map(bag, vehicle, args.output, messages, console)
            for kind in wanted:
                with console.status(f'Writing facade.{kind}'):
                    export(args.output, kind)
        except OSError as error:
            raise StriMappingError(f'{error.filename or args.output}: {error.strerror}') from None
    if failure is not None:
        console.print(f'What was computed so far is in {args.output}')
        raise failure
    return 0


def _map(
    bag: Bag, vehicle: Vehicle, folder: Path, messages: list[str], console: Console,
) -> BaseException | None:
    """Map a bag into a folder; return what stopped it, if anything, when all is written."""
    from stri_mapping.facade.finish import finish_facades
    from stri_mapping.mapping import Mapper
    from stri_mapping.report import write_report
    from stri_mapping.summary import write_summary

    with console.status('Preparing the estimator (compiled at the first run)'):
        mapper = Mapper(vehicle, folder)
    failure: BaseException | None = None
    try:
        if not _feed(mapper, bag, console):
            failure = KeyboardInterrupt()
    except StriMappingError as error:
        failure = error
    finally:
        with console.status('Writing the cloud'):
            mapper.finish()
    if failure is None and not mapper.moved:
        failure = StriMappingError(f'{bag.path}: {vehicle.horizontal.topic} gave no motion: too '
                                   'few scans, or too little in their view')
    facts = {'source': str(bag.path), 'complete': failure is None, **mapper.facts(bag.counts),
             'messages': messages + ([str(failure) or 'interrupted'] if failure else [])}
    with console.status('Drawing the facades'):
        facts.update(finish_facades(folder))
    summary = write_summary(folder, facts)
    with console.status('Drawing the report'):
        write_report(folder)
    print_summary(summary, folder, console)
    return failure


def _feed(mapper: Mapper, bag: Bag, console: Console) -> bool:
    """Give all scans of a bag to the mapper; return False when stopped by a signal."""
    from rich.progress import Progress, SpinnerColumn, TimeElapsedColumn, TimeRemainingColumn

    scanners = mapper.vehicle.scanners
    total = sum(bag.message_count(s.topic) for s in scanners)
    columns = (SpinnerColumn(), *Progress.get_default_columns()[:-1], TimeRemainingColumn(),
               TimeElapsedColumn())
    with _stop_signal() as stop, Progress(*columns, console=console) as progress:
        task = progress.add_task(f'Mapping {bag.path.name}', total=total or None)
        for number, (scanner, scan) in enumerate(bag.scans(scanners), start=1):
            mapper.add(scanner, scan)
            if number % PROGRESS_STEP == 0:
                progress.update(task, completed=number)
            if stop.is_set():
                return False
        progress.update(task, completed=total)
    return True


@contextmanager
def _stop_signal() -> Iterator[threading.Event]:
    """Turn the first Ctrl-C into an event, so that no scan is left half done; pass on others."""
    stop = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: FrameType | None) -> None:
        stop.set()
        signal.signal(signal.SIGINT, before)

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, note)
    try:
        yield stop
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, before)


@contextmanager
def kept_messages() -> Iterator[list[str]]:
    """Collect the package's warnings for the summary, the first of them if they are many."""
    kept: list[str] = []

    class Keeper(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if len(kept) < MESSAGES_KEPT:
                kept.append(record.getMessage())

    keeper = Keeper(logging.WARNING)
    logging.getLogger('stri_mapping').addHandler(keeper)
    try:
        yield kept
    finally:
        logging.getLogger('stri_mapping').removeHandler(keeper)


def print_summary(summary: dict[str, Any], folder: Path, console: Console) -> None:
    """Print the short result table."""
    from rich.table import Table

    table = Table(show_header=False, title=str(folder), title_justify='left')
    table.add_row('distance', f'{summary["distance_m"]:.1f} m in {summary["duration_s"]:.1f} s')
    table.add_row('horizontal scans', f'{summary["scans"]}, {summary["ms_per_scan"]:.2f} ms each')
    table.add_row('facade points', f'{summary["points"]}')
    table.add_row('real-time factor', f'{summary["real_time_factor"]:.1f}')
    table.add_row('not observable', f'{summary["degenerate_s"]:.1f} s')
    console.print(table)
    for warning in summary['warnings']:
        console.print(f'- {warning}', style='yellow', markup=False, highlight=False)
    console.print(f'Report: {folder / "report.html"}', highlight=False, soft_wrap=True)
