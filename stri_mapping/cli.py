# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The command `stri-mapping`: finds the sub-command, runs it, and turns errors into one line."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module
import logging
import os
from pkgutil import iter_modules
import sys

from stri_mapping import __version__, commands
from stri_mapping.errors import (
    EXIT_DATA,
    EXIT_INTERRUPTED,
    EXIT_USAGE,
    StriMappingError,
    UsageError,
)


def main(argv: Sequence[str] | None = None) -> int:
    """
    Run one command.

    Parameters
    ----------
    argv
        Arguments without the program's name; those of the process by default.

    Returns
    -------
    int
        The exit code: 0 done, 1 faulty data, 2 wrong usage, 130 interrupted.

    """
    logging.basicConfig(level=logging.WARNING, format='%(levelname)s: %(message)s')
    arguments = list(sys.argv[1:] if argv is None else argv)
    args = make_parser(arguments).parse_args(arguments)
    try:
        return int(args.run(args))
    except StriMappingError as error:
        print(f'stri-mapping {args.command}: {error}', file=sys.stderr)
        return EXIT_USAGE if isinstance(error, UsageError) else EXIT_DATA
    except BrokenPipeError:             # whoever read the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_DATA
    except KeyboardInterrupt:
        print(f'stri-mapping {args.command}: interrupted', file=sys.stderr)
        return EXIT_INTERRUPTED


def make_parser(arguments: Sequence[str] = ()) -> argparse.ArgumentParser:
    """Return the parser; where the arguments begin with a command, of that command alone."""
    parser = argparse.ArgumentParser(
        prog='stri-mapping',
        description="Map a street's facades from a moving vehicle with line scanners alone.",
        epilog='"stri-mapping COMMAND --help" tells more about one command.')
    parser.add_argument('--version', action='version', version=f'%(prog)s {__version__}')
    subparsers = parser.add_subparsers(dest='command', metavar='COMMAND', required=True)
    names = [module.name for module in iter_modules(commands.__path__)]
    if arguments and arguments[0] in names:
        names = [arguments[0]]
    for name in names:
        import_module(f'{commands.__name__}.{name}').add_parser(subparsers)
    return parser


if __name__ == '__main__':
    sys.exit(main())
