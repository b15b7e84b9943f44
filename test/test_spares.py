# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Spare processes: one for each kind of node, for whichever of them dies."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from stri_mapping.spares import Spares

# A spare that says what it was let run with, as `nodes/spare.py` would be it.
ECHO = 'import sys; print(sys.argv[1:2], sys.stdin.readline().strip())'


@pytest.fixture
def spares():
    spawned = []

    def spawn(module, arguments, nice):
        assert module == 'spare' and nice > 0
        process = subprocess.Popen([sys.executable, '-c', ECHO, *arguments], text=True,
                                   stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        spawned.append(process)
        return process

    yield Spares(spawn), spawned
    for process in spawned:
        process.kill()
        process.communicate()


def test_one_spare_serves_any_node_of_its_kind_once(spares):
    ready, spawned = spares
    assert ready.take('driver', []) is None
    for _ in range(3):
        ready.keep('driver')
    ready.keep('estimator')
    assert len(spawned) == 2
    taken = ready.take('driver', ['-r', '__ns:=/left'])
    assert taken is spawned[0]
    output, _ = taken.communicate(timeout=60)
    assert output.strip() == f"['driver'] {json.dumps(['-r', '__ns:=/left'])}"
    assert ready.take('driver', []) is None
    ready.keep('driver')
    assert len(spawned) == 3


def test_a_spare_that_has_died_is_none_and_the_others_end_with_the_supervisor(spares):
    ready, spawned = spares
    ready.keep('driver')
    ready.keep('estimator')
    spawned[0].kill()
    spawned[0].wait()
    assert ready.take('driver', []) is None
    ready.drop()
    assert spawned[1].poll() is not None
    assert ready.take('estimator', []) is None
