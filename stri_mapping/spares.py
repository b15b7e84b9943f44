# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that are ready to take the place of a node that dies, one for each kind of node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import json
import subprocess

# Of a spare that gets ready: it is not to slow down those that work.
SPARE_NICE = 10
# Once a spare is a node, its command line is to say so, which has no more room than it began with.
ROOM = 400 * ' '


class Spares:
    """
    Keeps one spare a module, whichever of the nodes of that module will need it.

    Parameters
    ----------
    spawn
        Starts a module of `stri_mapping.nodes` with arguments, at a niceness.

    """

    def __init__(self, spawn: Callable[[str, Sequence[str], int], subprocess.Popen[str]]) -> None:
        """Keep none yet."""
        self._spawn = spawn
        self._ready: dict[str, subprocess.Popen[str]] = {}

    def keep(self, module: str) -> None:
        """Have a spare for a module get ready, if there is none."""
        if module not in self._ready:
            self._ready[module] = self._spawn('spare', [module, ROOM], SPARE_NICE)

    def take(self, module: str, arguments: Sequence[str]) -> subprocess.Popen[str] | None:
        """Let a module's spare be a node with these arguments; None where there is none."""
        spare = self._ready.pop(module, None)
        if spare is None or spare.poll() is not None:
            return None
        assert spare.stdin is not None
        try:
            print(json.dumps(list(arguments)), file=spare.stdin, flush=True)
        except OSError:                 # it has just died too
            return None
        return spare

    def drop(self) -> None:
        """End all: no start will follow."""
        for spare in self._ready.values():
            spare.kill()
            spare.wait()
        self._ready.clear()
