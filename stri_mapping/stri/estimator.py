# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The STRI estimator: horizontal scans in, velocity and path out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stri_mapping.scan import Scan
from stri_mapping.stri.estimate import Estimate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EstimatorConfig:
    """Settings of the estimator; every default is usable."""


class StriEstimator:
    """Motion of base_link from the scans of one horizontal scanner."""

    def __init__(self, T_base_laser: Array, config: EstimatorConfig | None = None) -> None:
        """Take the scanner's mount, a (4, 4) transform; nothing is computed yet."""
        raise NotImplementedError

    def warm_up(self) -> None:
        """Compile what is not in the cache, so that no scan has to wait for it."""

    def add(self, scan: Scan) -> Estimate | None:
        """Take the next scan; return the estimate at its stamp, None while starting up."""

    def take_refined(self) -> list[Estimate]:
        """Return the estimates that became final since the last call, in order, one a scan."""

    def finish(self) -> None:
        """Make everything final: no scan will follow."""
