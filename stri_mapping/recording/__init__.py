# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Bags as they are written while driving: serialised messages that survive a crash."""
