# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""One node of the live graph as a process: started, started again, ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from stri_mapping.spares import Spares

# Tells a node the process id of its supervisor, which it does not outlive.
SUPERVISOR_VARIABLE = 'STRI_MAPPING_SUPERVISOR'
# Seconds a node may take for its end: it takes in its backlog and writes its results.
PATIENCE = 120.0
# Seconds after which a node that has not ended is asked again, by a signal that never kills: one
# of some hundred runs had an aligner that went on as if it had not been asked, cause unknown.
REMIND = 20.0
# Seconds before a node that died is started again: by how often in a row it has.
BACK_OFF = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
# Seconds after its start from which a node has a spare, if it is one that is started again.
SPARE_AFTER = 5.0
# A node that ran for so many seconds is started again as if for the first time.
SOUND = 30.0


@dataclass(frozen=True)
class NodeSpec:
    """
    One node of the graph.

    Attributes
    ----------
    module
        In `stri_mapping.nodes`; also the node's name.
    parameters
        Of the node.
    namespace
        Without slashes; empty for none.
    remappings
        New topic names by the node's own.
    source
        Whether the run is over when this node ends.
    vital
        Whether the run is over when this node fails for good.
    restarts
        Whether the node is started again when it dies.
    resumes
        Whether it then has something to go on with; its parameter `resume` is set.
    waits
        Whether the node is started only when those that do not wait are ready.
    nice
        Above 0 others go before it, below 0 it goes before others where that is allowed.

    """

    module: str
    parameters: Mapping[str, object] = field(default_factory=dict)
    namespace: str = ''
    remappings: Mapping[str, str] = field(default_factory=dict)
    source: bool = False
    vital: bool = True
    restarts: bool = True
    resumes: bool = True
    waits: bool = False
    nice: int = 0

    @property
    def name(self) -> str:
        """The node's full name without its first slash."""
        return f'{self.namespace}/{self.module}' if self.namespace else self.module

    def arguments(self, file: Path, resume: bool) -> list[str]:
        """Return its command line, given the file of all nodes' parameters."""
        rules = dict(self.remappings)
        if self.namespace:
            rules['__ns'] = f'/{self.namespace}'
        return ['--ros-args', '--params-file', str(file),
                *(part for old, new in rules.items() for part in ('-r', f'{old}:={new}')),
                *(['-p', 'resume:=true'] if resume and self.resumes else [])]


class Child:
    """
    A node as a process of its own group; its output is passed on with its name before it.

    Parameters
    ----------
    spec
        The node.
    file
        YAML file with the parameters of all nodes.
    prefix
        Put before each line of its output.
    spares
        Of all nodes.

    """

    def __init__(self, spec: NodeSpec, file: Path, prefix: str, spares: Spares) -> None:
        """Remember the node; nothing is started before `start`."""
        self.spec = spec
        self.restarts: list[str] = []            # why, each time
        self.failure: str | None = None          # how it ended for good
        self.died_at = 0.0
        self._file, self._prefix, self._spares = file, prefix, spares
        self._in_a_row = 0

    def start(self) -> None:
        """Start the process, or let a spare be it."""
        module = self.spec.module
        arguments = self.spec.arguments(self._file, resume=bool(self.restarts))
        self.process = self._spares.take(module, arguments) or spawn(module, arguments)
        # one that comes back has to catch up: it does not stand behind others until it has a spare
        self._catches_up = bool(self.restarts) and self.spec.nice > 0
        set_niceness(self.process.pid, 0 if self._catches_up else self.spec.nice)
        self.started_at, self.died_at, self._asked = time.monotonic(), 0.0, False
        self._pump = threading.Thread(target=self._pass_on, daemon=True)
        self._pump.start()

    def keep_spare(self) -> None:
        """Have a process ready for the next start, once the node has run for a while."""
        if (self.spec.restarts and not self.died_at
                and time.monotonic() - self.started_at > SPARE_AFTER):
            self._spares.keep(self.spec.module)
            if self._catches_up:
                self._catches_up = False
                set_niceness(self.process.pid, self.spec.nice)

    @property
    def started(self) -> bool:
        """Whether the process has been started at all."""
        return hasattr(self, 'process')

    def _pass_on(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.say(line.rstrip())

    def say(self, text: str) -> None:
        """Print a line with the node's name."""
        try:
            print(f'{self._prefix}{text}', flush=True)
        except OSError:             # nobody reads on; the node must not block for it
            pass

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the process and what it may have started."""
        try:
            os.killpg(self.process.pid, number)
        except ProcessLookupError:
            pass

    def revive(self, code: int) -> None:
        """Start the process again some time after it died; called until it runs."""
        now = time.monotonic()
        if not self.died_at:
            self.died_at = now
            self.signal(signal.SIGKILL)          # what it may have left behind
            self._in_a_row = 0 if now - self.started_at > SOUND else self._in_a_row
            self.say(f'{describe(code)}; it is started again')
        if now - self.died_at >= BACK_OFF[min(self._in_a_row, len(BACK_OFF) - 1)]:
            self._in_a_row += 1
            self.restarts.append(describe(code))
            self.start()

    @property
    def hopeless(self) -> bool:
        """Whether it has died so often in a row that another start is no use."""
        return (self._in_a_row >= len(BACK_OFF) and not self.died_at
                and time.monotonic() - self.started_at < SOUND)

    def ask_to_end(self) -> None:
        """Stop the process as by Ctrl-C, once: a second time would kill it."""
        if self.process.poll() is None and not self._asked:
            self.signal(signal.SIGINT)
        self._asked = True

    def end(self, patience: float = PATIENCE) -> int:
        """Wait for the process asked to end, kill it when it does not; return its exit code."""
        self.ask_to_end()
        deadline = time.monotonic() + patience
        while self.process.poll() is None:
            left = deadline - time.monotonic()
            try:
                self.process.wait(max(min(left, REMIND), 0.0))
            except subprocess.TimeoutExpired:
                if left <= REMIND:
                    self.say(f'did not end within {patience:.0f} s: killed')
                    self.signal(signal.SIGKILL)
                    break
                self.say('has not ended yet: asked again')
                self.signal(signal.SIGHUP)
        code = self.process.wait()
        self._pump.join(1.0)
        return code


def spawn(module: str, arguments: Sequence[str], nice: int = 0) -> subprocess.Popen[str]:
    """Start a module of `stri_mapping.nodes` as a child of this supervisor."""
    environment = {
        **os.environ, SUPERVISOR_VARIABLE: str(os.getpid()), 'PYTHONUNBUFFERED': '1',
        'RCUTILS_CONSOLE_OUTPUT_FORMAT': '{severity}: {message}'}
    process = subprocess.Popen(
        [sys.executable, '-m', f'stri_mapping.nodes.{module}', *arguments],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, errors='replace', env=environment, start_new_session=True)
    set_niceness(process.pid, nice)
    return process


def set_niceness(pid: int, nice: int) -> None:
    """Give a process, and its session where those are what shares, a niceness if allowed."""
    try:
        os.setpriority(os.PRIO_PROCESS, pid, nice)
        Path(f'/proc/{pid}/autogroup').write_text(str(nice), encoding='ascii')
    except OSError:                 # not ours to say, or a system without such groups
        pass


def describe(code: int) -> str:
    """Return in words how a process ended."""
    if code < 0:
        return f'was killed by {signal.Signals(-code).name}'
    return f'failed with exit code {code}' if code else 'ended before its source'
