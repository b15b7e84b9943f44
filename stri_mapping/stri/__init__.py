# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The spatio-temporal range image of the horizontal scanner, and the motion read from it."""
