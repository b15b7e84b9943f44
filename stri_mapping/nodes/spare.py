# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
A node that is ready to take another's place: imported and compiled, but not yet started.

Starting Python, importing and loading compiled code take seconds that a moving vehicle has not.
The supervisor keeps such a process for each kind of node (`stri_mapping.spares`), and lets it run
when one of them has died.  Called with the node's module; runs when told the node's arguments, a
line of JSON on its standard input, and ends when that is closed.
"""

from __future__ import annotations

from importlib import import_module
import json
import os
import sys


def main() -> int:
    """Get ready, wait, be the node."""
    name = f'stri_mapping.nodes.{sys.argv[1]}'
    module = import_module(name)
    if hasattr(module, 'prepare'):
        module.prepare()
    line = sys.stdin.readline()
    if not line:
        return 0
    sys.argv = [name, *json.loads(line)]
    os.environ['SPT_NOENV'] = '1'        # its environment stays where others can read it
    try:
        from setproctitle import setproctitle
    except ImportError:
        pass
    else:                               # in the list of processes it is now what it stands for
        setproctitle(' '.join([sys.executable, '-m', *sys.argv]))
    return int(module.main())


if __name__ == '__main__':
    sys.exit(main())
