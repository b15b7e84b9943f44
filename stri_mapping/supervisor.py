# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The live graph's processes under one supervisor: started, watched, restarted, ended in order.

It serves where ROS 2's own launch system is not to be had, and knows what that does not: that
the drive is over when its source has ended, that each node must be stopped only after the one
that feeds it has given everything, and that a node which died goes on with what it has on disk.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
import signal
import sys
import time
from types import FrameType, TracebackType

import yaml

from stri_mapping.errors import EXIT_DATA, EXIT_USAGE
from stri_mapping.node_process import Child, describe, NodeSpec, spawn
from stri_mapping.spares import Spares

POLL = 0.02
# Seconds between two looks of who watches the run.
LOOK = 0.5
COLOURS = ('\033[36m', '\033[33m', '\033[35m', '\033[32m', '\033[34m')
PLAIN = '\033[0m'
# Terminated at once when the supervisor is told a second time.
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Supervisor:
    """
    Runs some nodes until their source ends, a vital one fails for good, or Ctrl-C.

    A context manager, on leaving which no process is left.  The first SIGINT or SIGTERM ends the
    run in order; a second one kills everything.

    Parameters
    ----------
    folder
        Existing folder; the nodes' parameters are kept there as parameters.yaml.
    stages
        The nodes in the order in which they are to end, those of one stage together.

    Attributes
    ----------
    interrupted
        Whether a signal came.
    failure
        Which node failed for good and how, if one that is vital did.
    remarks
        What happened to nodes without ending the run, one line each.

    """

    def __init__(self, folder: Path, stages: Sequence[Sequence[NodeSpec]]) -> None:
        """Remember what to run; nothing is started before `run`."""
        self.interrupted = False
        self.failure: str | None = None
        self.remarks: list[str] = []
        specs = [spec for stage in stages for spec in stage]
        file = folder / 'parameters.yaml'
        file.write_text(yaml.safe_dump(
            {f'/{spec.name}': {'ros__parameters': dict(spec.parameters)} for spec in specs},
            sort_keys=False), encoding='utf-8')
        width = max(len(spec.name) for spec in specs)
        colours = COLOURS if sys.stdout.isatty() else ('',)
        self._spares = Spares(spawn)
        children = [Child(spec, file, f'{colours[i % len(colours)]}{spec.name:<{width}}'
                          f'{PLAIN if colours[0] else ""} | ', self._spares)
                    for i, spec in enumerate(specs)]
        self.children = tuple(children)
        rest = iter(children)
        self._stages = [[next(rest) for _ in stage] for stage in stages]

    def __enter__(self) -> Supervisor:
        """Take over SIGINT and SIGTERM."""
        self._handlers = {number: signal.signal(number, self._on_signal)
                          for number in STOP_SIGNALS}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Kill what is still there, and give the signals back."""
        self._spares.drop()
        for child in self._running():
            child.signal(signal.SIGKILL)
            child.process.wait()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True

    def _running(self) -> list[Child]:
        return [child for child in self.children if child.started]

    def run(
        self, look: Callable[[Sequence[Child]], None] = lambda _: None,
        ready: Callable[[str], bool] = lambda _: True,
    ) -> int:
        """
        Run the graph.

        Parameters
        ----------
        look
            Called with all nodes every half second.
        ready
            Whether a node, by its name, is ready for others to be started.

        Returns
        -------
        int
            0 if every node ended well, else the exit code of the first that did not (1 if a
            signal killed it).

        """
        failed = self._watch(look, ready)
        codes = self._end(look)
        for child in self._running():
            self.remarks += [f'{child.spec.name} {why}; it was started again'
                             for why in child.restarts]
            if codes[child] and child.failure is None:
                child.failure = describe(codes[child])
            if child.failure is not None and child.spec.vital:
                failed = failed or child
            elif child.failure is not None:
                self.remarks.append(f'{child.spec.name} {child.failure}')
        if failed is None:
            return next((EXIT_DATA for c in self._running() if c.failure is not None), 0)
        self.failure = f'{failed.spec.name} {failed.failure}'
        print(self.failure, file=sys.stderr, flush=True)
        return max(codes[failed], EXIT_DATA)

    def _watch(
        self, look: Callable[[Sequence[Child]], None], ready: Callable[[str], bool],
    ) -> Child | None:
        """Keep the nodes running until the end; return the one whose failure is the end."""
        looked = 0.0
        while not self.interrupted:
            for child in self.children:
                if not child.started:
                    if self._may_start(child, ready):
                        child.start()
                elif (code := child.process.poll()) is not None and child.failure is None:
                    if child.spec.source and code == 0:
                        return None
                    if self._is_lost(child, code):
                        return child
                else:
                    child.keep_spare()
            if time.monotonic() > looked + LOOK:
                looked = time.monotonic()
                look(self.children)
            time.sleep(POLL)
        return None

    def _may_start(self, child: Child, ready: Callable[[str], bool]) -> bool:
        return not child.spec.waits or all(
            other.started and ready(other.spec.name)
            for other in self.children if not other.spec.waits)

    def _is_lost(self, child: Child, code: int) -> bool:
        """See to a node that ended; return whether that is the end of the run."""
        gave_up = code in (0, EXIT_DATA, EXIT_USAGE)        # it has said why
        if child.spec.restarts and not gave_up and not child.hopeless:
            child.revive(code)
            return False
        child.failure = describe(code)
        if not child.spec.vital:
            child.say(child.failure)
        return child.spec.vital

    def _end(self, look: Callable[[Sequence[Child]], None]) -> dict[Child, int]:
        """End the stages one after the other; return the exit codes."""
        codes = {}
        self._spares.drop()
        for stage in self._stages:
            running = [child for child in stage if child.started]
            for child in running:
                child.ask_to_end()
            for child in running:
                codes[child] = child.end()
            look(self.children)
        return codes
