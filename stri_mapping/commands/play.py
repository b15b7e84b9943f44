# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping play`: a bag through DDS with /clock, for any nodes that listen."""

from __future__ import annotations

import argparse
from pathlib import Path
import tempfile
from typing import Any

from stri_mapping.errors import EXIT_INTERRUPTED, UsageError


def add_parser(subparsers: Any) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        'play', help='play a bag onto ROS topics',
        description='Publish the messages of a bag as they were recorded, with /clock. '
        'Subscribers should be up before: what comes before they are connected is lost.')
    parser.add_argument('bag', type=Path, metavar='BAG',
                        help='rosbag2 directory, .mcap file or ROS 1 .bag file')
    parser.add_argument('--rate', type=rate, default=1.0, metavar='R',
                        help='speed over that of recording; 0 for as fast as it is taken '
                        '(default: %(default)s)')
    parser.add_argument('--start', type=float, default=0.0, metavar='S',
                        help='seconds to leave out at the beginning (0)')
    parser.add_argument('--duration', type=float, default=0.0, metavar='S',
                        help='seconds to play (all)')
    parser.add_argument('--loop', action='store_true',
                        help='begin again at the end, until Ctrl-C')
    parser.set_defaults(run=run)


def rate(text: str) -> float:
    """Return a playing rate; for argparse."""
    value = float(text)
    if not 0.0 <= value < float('inf'):
        raise argparse.ArgumentTypeError(f'{text}: want 0 or a positive number')
    return value


def require_ros() -> None:
    """Raise UsageError, saying what to do, unless ROS 2 is there."""
    from importlib.util import find_spec
    if find_spec('rclpy') is None:
        raise UsageError('ROS 2 is not installed for this Python: source your ROS 2 Jazzy '
                         'set-up, or run "pip install stri_mapping[ros]"')


def run(args: argparse.Namespace) -> int:
    """Play the bag; return the player's exit code."""
    from stri_mapping.bag_io import Bag
    from stri_mapping.node_process import NodeSpec
    from stri_mapping.supervisor import Supervisor

    require_ros()
    with Bag(args.bag):
        pass                        # a bag that cannot be read is said before ROS is started
    player = NodeSpec('bag_player', {
        'bag': str(args.bag.resolve()), 'rate': args.rate, 'start': args.start,
        'duration': args.duration, 'loop': args.loop}, source=True, restarts=False)
    with tempfile.TemporaryDirectory() as folder, Supervisor(Path(folder), [[player]]) as graph:
        code = graph.run()
    return EXIT_INTERRUPTED if graph.interrupted and code == 0 else code
