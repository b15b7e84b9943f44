# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Facades: vertical scan lines put where the vehicle was, and the files they end in."""
