# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Results that a node writes for as long as the disk takes them; the drive does not need them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from rclpy.node import Node

from stri_mapping.errors import ResultsError
from stri_mapping.nodes.diagnostics import ERROR, Report
from stri_mapping.summary import write_summary


class Writer(Protocol):
    """What writes results."""

    def close(self) -> None:
        """Finish all files."""

    def abandon(self) -> None:
        """Leave what was written whole, since no more can be."""


class ResultsOutput:
    """
    Writes while that is possible, and says so once when it is not any more.

    Parameters
    ----------
    node
        Whose results they are.
    folder
        Existing results folder; None if no results are wanted.
    writer
        Owner of the files that grow in it.

    Attributes
    ----------
    fault
        Why nothing is written any more, None while all is well.

    """

    def __init__(self, node: Node, folder: Path | None, writer: Writer | None) -> None:
        """Begin with all well."""
        self._node, self._folder, self._writer = node, folder, writer
        self.fault: ResultsError | None = None

    @property
    def wanted(self) -> bool:
        """Whether there are results, and they are not closed yet."""
        return self._folder is not None

    def write(self, action: Callable[[], object]) -> None:
        """Let something be written, unless that is not wanted or has failed before."""
        if self._folder is None or self.fault is not None:
            return
        try:
            action()
        except ResultsError as error:
            self.fault = error
            self._node.get_logger().error(f'{error}; the drive goes on, its results do not')
            if self._writer is not None:
                self._writer.abandon()

    def close(self, facts: Callable[[], Mapping[str, Any]]) -> None:
        """Finish the files and add what the node knows to the summary; later calls do nothing."""
        if self._folder is not None and self._writer is not None:
            self.write(self._writer.close)
            with suppress(ResultsError):        # whoever started the node tells that it is missing
                write_summary(self._folder, facts())
        self._folder = None

    def report(self, report: Report) -> Report:
        """Return what the node says of itself, or that its results are not written."""
        return report if self.fault is None else Report(ERROR, str(self.fault), report.values)

    def check(self) -> None:
        """Raise the fault, if there was one: the results are not whole."""
        if self.fault is not None:
            raise self.fault
