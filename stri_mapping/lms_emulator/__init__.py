# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
SICK LMS 2xx scanners without hardware: the same bytes at the same times, behind pseudo terminals.

`device` is a scanner as a pure state machine over given times, `ports` runs some of them behind
ptys at true times.  Facts and their sources: docs/driver.md.
"""
