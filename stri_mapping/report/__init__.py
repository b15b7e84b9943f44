# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The report: one self-contained page made from the files of a results folder alone."""

from stri_mapping.report.page import write_report

__all__ = ['write_report']
