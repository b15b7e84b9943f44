# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The end of a node's process: asked, asked again, killed."""

from __future__ import annotations

from pathlib import Path
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

from live import listener
import pytest

from stri_mapping import node_process
from stri_mapping.node_process import Child, NodeSpec
from stri_mapping.spares import Spares

DEAF = """
import signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
signal.signal(signal.SIGHUP, {on_hangup})
print('up', flush=True)
while True:
    signal.pause()
"""


@pytest.fixture
def start(monkeypatch, tmp_path: Path):
    """Start a process that takes no notice of SIGINT, and does something on SIGHUP."""
    children = []

    def started(on_hangup: str) -> Child:
        def spawn(module: str, arguments: list[str]) -> subprocess.Popen[str]:
            process = subprocess.Popen(
                [sys.executable, '-c', DEAF.format(on_hangup=on_hangup)], text=True,
                stdout=subprocess.PIPE, start_new_session=True)
            assert process.stdout is not None
            assert process.stdout.readline() == 'up\n'
            return process

        monkeypatch.setattr(node_process, 'spawn', spawn)
        child = Child(NodeSpec('facade_aligner'), tmp_path / 'parameters.yaml', '| ',
                      Spares(spawn))
        children.append(child)
        child.start()
        return child

    yield started
    for child in children:
        child.signal(signal.SIGKILL)


def test_a_node_that_goes_on_is_asked_again_and_ends_by_itself(start, monkeypatch, capsys):
    monkeypatch.setattr(node_process, 'REMIND', 0.2)
    child = start('lambda *_: sys.exit(0)')
    assert child.end(patience=60.0) == 0
    assert 'asked again' in capsys.readouterr().out


def test_a_node_that_never_ends_is_killed(start, monkeypatch, capsys):
    monkeypatch.setattr(node_process, 'REMIND', 0.2)
    child = start('signal.SIG_IGN')
    assert child.end(patience=1.0) == -signal.SIGKILL
    said = capsys.readouterr().out
    assert said.count('asked again') >= 1 and 'did not end within 1 s: killed' in said


def test_a_node_to_which_something_always_comes_ends_all_the_same():
    pytest.importorskip('rclpy')
    from stri_mapping.nodes import process
    with listener() as (node, executor, _):
        ticks = []
        node.create_timer(0.2 * process.QUIET, lambda: ticks.append(time.monotonic()))
        until = time.monotonic() + 10.0 * process.QUIET
        process._take_rest(SimpleNamespace(node=node, inputs=()), executor, until)
        assert time.monotonic() >= until and len(ticks) > 10
