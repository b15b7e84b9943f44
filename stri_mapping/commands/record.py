# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping record`: ROS topics into a bag."""

from __future__ import annotations

import argparse
from pathlib import Path
import tempfile
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        'record', help='record ROS topics into a bag',
        description='Record what is published, byte for byte, until Ctrl-C. What has been '
        'recorded is safe within a tenth of a second; "stri-mapping repair" completes a bag '
        'that a crash cut off.')
    parser.add_argument('topics', nargs='*', metavar='TOPIC', help='what to record (all)')
    parser.add_argument('--output', type=Path, required=True, metavar='BAG',
                        help='directory to make')
    parser.add_argument('--exclude', nargs='+', default=[], metavar='TOPIC',
                        help='what to leave out; a name that ends in / means all below it')
    parser.add_argument('--split-size', type=positive, default=0.0, metavar='MB',
                        help='begin a new file after so many megabytes (never)')
    parser.add_argument('--split-duration', type=positive, default=0.0, metavar='S',
                        help='begin a new file after so many seconds (never)')
    parser.set_defaults(run=run)


def positive(text: str) -> float:
    """Return a positive number; for argparse."""
    value = float(text)
    if not 0.0 < value < float('inf'):
        raise argparse.ArgumentTypeError(f'{text}: want a positive number')
    return value


def run(args: argparse.Namespace) -> int:
    """Record; return 0 also after Ctrl-C, which is how a recording ends."""
    from stri_mapping.commands.play import require_ros
    from stri_mapping.errors import BagError
    from stri_mapping.node_process import NodeSpec
    from stri_mapping.supervisor import Supervisor

    require_ros()
    if args.output.exists():
        raise BagError(f'{args.output}: exists already; name a new directory')
    recorder = NodeSpec('bag_recorder', {
        'path': str(args.output.resolve()), 'topics': ' '.join(args.topics),
        'exclude': ' '.join(args.exclude), 'split_size': args.split_size,
        'split_duration': args.split_duration}, source=True)
    with tempfile.TemporaryDirectory() as folder, Supervisor(Path(folder), [[recorder]]) as graph:
        return graph.run()
