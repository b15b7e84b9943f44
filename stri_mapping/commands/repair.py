# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`stri-mapping repair`: a recording that a crash cut off, made readable again."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        'repair', help='make a recording that was cut off readable again',
        description='Find every whole message of a recording that was cut off, by a crash or by '
        'loss of power, and complete the bag in its place. A damaged file is kept beside the new '
        'one, with ".damaged" added to its name.')
    parser.add_argument('bag', type=Path, metavar='BAG',
                        help='directory of the bag, or a single .mcap file')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """
    Repair the bag and say what was done.

    Raises
    ------
    BagError
        If there is nothing to repair or the disk does not take it.

    """
    from stri_mapping.recording.repair import DAMAGED, repair

    done = repair(args.bag)
    print(f'{args.bag}: {done.messages} messages')
    for name in done.mended:
        print(f'{name} was cut off and is whole again; the old one is {name}{DAMAGED}')
    if done.unreadable:
        print(f'{done.unreadable} bytes gave no message')
    return 0
