# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The commands of `stri-mapping`, one module each.

A module `x` has ``add_parser(subparsers)``, which describes the command ``x`` and sets its
``run(args) -> int`` as the parser's default.  What takes long to import is imported in `run`.
"""
