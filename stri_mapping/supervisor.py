# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The live graph's processes under one supervisor: started, watched and ended in order.

It serves where ROS 2's own launch system is not to be had, and knows what that does not: that
the drive is over when its source has ended, and that each node must be stopped only after the
one that feeds it has given everything.
"""

from __future__ import annotations

from collections.abc import Mapping
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time
from types import FrameType, TracebackType

import yaml

# Tells a node the process id of its supervisor, which it does not outlive.
SUPERVISOR_VARIABLE = 'STRI_MAPPING_SUPERVISOR'
# Seconds a node may take for its end: it takes in its backlog and writes its results.
PATIENCE = 120.0
POLL = 0.02
COLOURS = ('\033[36m', '\033[33m', '\033[35m', '\033[32m', '\033[34m')
PLAIN = '\033[0m'
NAME_WIDTH = 14


class Child:
    """
    One node as a process of its own group; its output is passed on with its name before it.

    Parameters
    ----------
    name
        Module of the node in `stri_mapping.nodes`.
    parameters
        YAML file with its parameters.
    colour
        Terminal sequence for the name; empty for none.

    """

    def __init__(self, name: str, parameters: Path, colour: str = '') -> None:
        """Start the process."""
        self.name = name
        environment = {
            **os.environ, SUPERVISOR_VARIABLE: str(os.getpid()), 'PYTHONUNBUFFERED': '1',
            'RCUTILS_CONSOLE_OUTPUT_FORMAT': '{severity}: {message}'}
        self.process = subprocess.Popen(
            [sys.executable, '-m', f'stri_mapping.nodes.{name}', '--ros-args', '--params-file',
             str(parameters)],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors='replace', env=environment, start_new_session=True)
        self._prefix = f'{colour}{name:<{NAME_WIDTH}}{PLAIN if colour else ""} | '
        self._pump = threading.Thread(target=self._pass_on, daemon=True)
        self._pump.start()

    def _pass_on(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            try:
                print(f'{self._prefix}{line.rstrip()}', flush=True)
            except OSError:         # nobody reads on; the node must not block for it
                pass

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the process and what it may have started."""
        try:
            os.killpg(self.process.pid, number)
        except ProcessLookupError:
            pass

    def end(self, patience: float = PATIENCE) -> int:
        """Stop the process as by Ctrl-C, kill it when it does not end; return its exit code."""
        if self.process.poll() is None:
            self.signal(signal.SIGINT)
        try:
            self.process.wait(patience)
        except subprocess.TimeoutExpired:
            print(f'{self._prefix}did not end within {patience:.0f} s: killed', flush=True)
            self.signal(signal.SIGKILL)
        code = self.process.wait()
        self._pump.join(1.0)
        return code


class Supervisor:
    """
    Runs some nodes until their source ends, one of them fails, or Ctrl-C; a context manager.

    On leaving the context no process is left.  The first SIGINT or SIGTERM ends the run in order;
    a second one kills everything.

    Parameters
    ----------
    folder
        Existing folder; the nodes' parameters are kept there as parameters.yaml.
    parameters
        By node: its parameters.

    """

    def __init__(self, folder: Path, parameters: Mapping[str, Mapping[str, object]]) -> None:
        """Remember what to run; nothing is started before `run`."""
        self.interrupted = False
        self.failure: str | None = None          # which node failed and how
        self._children: list[Child] = []
        self._names = list(parameters)
        self._file = folder / 'parameters.yaml'
        self._file.write_text(yaml.safe_dump(
            {name: {'ros__parameters': dict(values)} for name, values in parameters.items()},
            sort_keys=False), encoding='utf-8')

    def __enter__(self) -> Supervisor:
        """Take over SIGINT and SIGTERM."""
        self._handlers = {number: signal.signal(number, self._on_signal)
                          for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Kill what is still there, and give the signals back."""
        for child in self._children:
            child.signal(signal.SIGKILL)
            child.process.wait()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True

    def run(self) -> int:
        """
        Run the graph, the first node being its source: when it ends, all is over.

        Returns
        -------
        int
            0 if every node ended well, else the exit code of the first that did not (1 if a
            signal killed it).

        """
        colours = COLOURS if sys.stdout.isatty() else ('',)
        for index, name in enumerate(self._names):
            self._children.append(Child(name, self._file, colours[index % len(colours)]))
        failed = self._watch()
        codes = {child.name: child.end() for child in self._children}
        if failed is None:
            failed = next((child for child in self._children if codes[child.name]), None)
        if failed is None:
            return 0
        code = codes[failed.name]
        self.failure = f'{failed.name} {describe(code)}'
        print(self.failure, file=sys.stderr, flush=True)
        return max(code, 1)

    def _watch(self) -> Child | None:
        """Wait for the end of the source or an interrupt; return a node that failed before."""
        source = self._children[0]
        while not self.interrupted:
            for child in self._children:
                code = child.process.poll()
                if code is not None and (code != 0 or child is not source):
                    return child
            if source.process.poll() == 0:
                return None
            time.sleep(POLL)
        return None


def describe(code: int) -> str:
    """Return in words how a process ended."""
    if code < 0:
        return f'was killed by {signal.Signals(-code).name}'
    return f'failed with exit code {code}' if code else 'ended before its source'
