# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The live graph on one screen, or a line now and then where there is no screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import os
from pathlib import Path
import shutil
import time
from types import TracebackType
from typing import NamedTuple

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from stri_mapping.node_process import Child

TICKS, PAGE = os.sysconf('SC_CLK_TCK'), os.sysconf('SC_PAGE_SIZE')
# Seconds after which what a node last said no longer counts, and between two plain lines.
STALE, LINE_PERIOD = 3.5, 5.0
LEVELS = ('green', 'yellow', 'red', 'red')
# What the diagnostics of a node tell that belongs on the screen, in this order.
FIGURES = ('Rate', 'Lost scans', 'Latency', 'Points', 'Messages', 'Megabytes left on the disk')


class NodeStatus(NamedTuple):
    """What a node last said of itself."""

    level: int                  # 0 good, 1 warning, 2 error
    message: str
    values: Mapping[str, str]
    heard: float                # on the monotonic clock


class Load(NamedTuple):
    """What a process takes of the machine."""

    cpu_s: float                # processor seconds so far
    memory: int                 # bytes resident


def load_of(pid: int) -> Load:
    """Return the load of a process; zeros when it is gone."""
    try:
        fields = Path(f'/proc/{pid}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
        return Load((int(fields[11]) + int(fields[12])) / TICKS, int(fields[21]) * PAGE)
    except (OSError, IndexError):
        return Load(0.0, 0)


class StatusBoard:
    """
    Shows the state of all nodes while they run; a context manager.

    Parameters
    ----------
    console
        Where to; a full screen on a terminal, plain lines elsewhere.
    folder
        On the disk whose room is shown.

    """

    def __init__(self, console: Console, folder: Path) -> None:
        """Show nothing yet."""
        self._folder = folder
        self._console = console
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._began = self._spoken = time.monotonic()
        self._before: dict[int, tuple[float, float]] = {}    # by process: clock, its CPU seconds

    def __enter__(self) -> StatusBoard:
        """Take over the screen's last lines."""
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give the screen back."""
        if self._live is not None:
            self._live.stop()

    def show(self, children: Sequence[Child], statuses: Mapping[str, NodeStatus]) -> None:
        """Show the present state; called a few times a second."""
        now = time.monotonic()
        if self._live is not None:
            shares = {child: self._share(child, now) for child in children}
            self._live.update(Group(self._table(children, statuses, shares),
                                    Text(self._line(statuses, sum(shares.values())))),
                              refresh=True)
        elif now > self._spoken + LINE_PERIOD:
            self._spoken = now
            total = sum(self._share(child, now) for child in children)
            self._console.print(self._line(statuses, total), highlight=False, soft_wrap=True)

    def _share(self, child: Child, now: float) -> float:
        """Return what share of a processor a node took since the last look."""
        if not child.started or child.process.poll() is not None:
            return 0.0
        pid, spent = child.process.pid, load_of(child.process.pid).cpu_s
        then, before = self._before.get(pid, (child.started_at, 0.0))
        self._before[pid] = (now, spent)
        return (spent - before) / max(now - then, 1e-3)

    def _line(self, statuses: Mapping[str, NodeStatus], cpu: float) -> str:
        motion = statuses.get('stri_estimator')
        parts = [f'{time.monotonic() - self._began:.0f} s']
        if motion is not None:
            parts += [motion.message] + [
                f'{key.lower()} {motion.values[key]}' for key in ('Speed', 'Distance', 'Quality')
                if key in motion.values]
        lost = [int(s.values['Lost scans']) for s in statuses.values()
                if s.values.get('Lost scans', '').isdigit()]
        parts += [f'lost scans {sum(lost)}'] if lost else []
        free = shutil.disk_usage(self._folder).free
        return ' · '.join([*parts, f'{free / 1e9:.1f} GB left', f'CPU {100 * cpu:.0f} %'])

    def _table(
        self, children: Sequence[Child], statuses: Mapping[str, NodeStatus],
        shares: Mapping[Child, float],
    ) -> Table:
        table = Table(box=None, pad_edge=False)
        for title, side in (('node', 'left'), ('state', 'left'), ('CPU', 'right'),
                            ('memory', 'right'), ('', 'left')):
            table.add_column(title, justify='right' if side == 'right' else 'left')
        for child in children:
            status = statuses.get(child.spec.name)
            state, colour = self._state(child, status)
            figures = '  '.join(f'{key.lower()} {status.values[key]}' for key in FIGURES
                                if key in status.values) if status else ''
            memory = load_of(child.process.pid).memory if child.started else 0
            table.add_row(child.spec.name, Text(state, colour), f'{100 * shares[child]:.0f} %',
                          f'{memory / 1e6:.0f} MB', figures)
        return table

    def _state(self, child: Child, status: NodeStatus | None) -> tuple[str, str]:
        """Return a node's state in words, and their colour."""
        if not child.started:
            return 'waiting', 'dim'
        if child.failure is not None:
            return child.failure, 'red'
        code = child.process.poll()
        if code is not None:
            return ('ended', 'dim') if code == 0 else ('is started again', 'red')
        if status is None or status.heard < child.started_at:
            return 'starting', 'dim'
        if status.heard < time.monotonic() - STALE:
            return 'silent', 'red'
        again = f' (restarted {len(child.restarts)}x)' if child.restarts else ''
        return status.message + again, LEVELS[min(status.level, 3)]
