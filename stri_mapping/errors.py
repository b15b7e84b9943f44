# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Errors that callers can act on; each message is one line a user can follow."""

# Exit codes of commands and nodes; EXIT_CRASH is a fault of the program itself.
EXIT_DATA, EXIT_USAGE, EXIT_CRASH, EXIT_INTERRUPTED = 1, 2, 70, 130


class StriMappingError(Exception):
    """Base of every error this package raises on purpose."""


class BagError(StriMappingError):
    """A bag is missing, broken, or does not hold what was asked of it."""


class VehicleError(StriMappingError):
    """The vehicle description is missing, malformed or contradictory."""


class ScanError(StriMappingError):
    """A scan whose fields contradict one another."""


class TrajectoryError(StriMappingError):
    """A trajectory file or operation that cannot be honoured."""


class ResultsError(StriMappingError):
    """Results cannot be written, as on a full disk; those written before are whole."""


class LmsError(StriMappingError):
    """A scanner, its port or its bytes are not what they should be."""


class UsageError(StriMappingError):
    """A command was called with arguments that cannot work together."""


class LmsSettingError(LmsError, UsageError):
    """Settings that the scanner which was found does not have."""
