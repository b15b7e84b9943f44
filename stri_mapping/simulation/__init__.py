# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The virtual vehicle: streets, motions and SICK LMS 2xx scanners that measure them.

`drive.simulate` is the way in; `scenes` names the drives, `scanner` is the sensor model.
"""
