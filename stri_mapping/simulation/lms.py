# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The SICK LMS 2xx types and settings the virtual scanner knows.

Numbers are from SICK's technical description of the LMS200/211/221/291 (accuracy, optics) and
its telegram listing (angles 10, timing 10.10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stri_mapping.errors import UsageError

Array = NDArray[np.float64]

# Bytes a second at 500 kBd, ten bits a byte, and the bytes of a telegram beside its ranges.
BYTE_RATE = 50000.0
OVERHEAD = 10


@dataclass(frozen=True)
class LmsModel:
    """
    One scanner type in one of its settings.

    Attributes
    ----------
    field, resolution
        Degrees: the arc scanned, and the step between neighbouring rays of a full scan.  Every
        turn of the mirror fires at steps of 1 degree; finer ones come from shifting the raster
        for the next turn.
    quantisation
        Metres, the unit the scanner sends: 0.01 or 0.001.
    range_max
        Metres, the largest range it can send.
    noise
        Standard deviation in metres up to 20 m; beyond, it grows with range.
    reach
        Metres at which a 10 % target met head-on is just seen.
    divergence, spot
        Full angle of the beam in radians, and its diameter at the window in metres.
    dropout
        Share of rays lost for no reason.
    echo
        What it makes of a footprint, see `beam.echo_range`.

    """

    field: float = 180.0
    resolution: float = 1.0
    quantisation: float = 0.01
    range_max: float = 80.0
    noise: float = 0.010
    reach: float = 30.0
    divergence: float = 0.0119
    spot: float = 0.016
    dropout: float = 2e-4
    echo: str = 'pulse'

    @property
    def rasters(self) -> int:
        """Mirror turns that make a full scan: 1, 2 or 4."""
        return round(1.0 / self.resolution)

    def bearings(self, raster: int) -> Array:
        """Return the bearings (n,) in degrees of one mirror turn, 0 straight ahead."""
        first = -0.5 * self.field + raster * self.resolution
        return np.arange(first, 0.5 * self.field + 1e-9)

    def transfer(self, rays: int) -> float:
        """Return the seconds that a telegram of so many rays takes on the line at 500 kBd."""
        return (2 * rays + OVERHEAD) / BYTE_RATE


# The outdoor types (211, 221, 291) by field and resolution, and an indoor LMS200 in mm mode.
VARIANTS: dict[str, LmsModel] = {
    '180x1': LmsModel(),
    '180x0.5': LmsModel(resolution=0.5),
    '100x1': LmsModel(field=100.0),
    '100x0.5': LmsModel(field=100.0, resolution=0.5),
    '100x0.25': LmsModel(field=100.0, resolution=0.25),
    '180x1mm': LmsModel(quantisation=0.001, range_max=32.0),
    'indoor': LmsModel(quantisation=0.001, range_max=32.0, noise=0.005, reach=10.0,
                       divergence=0.0044, spot=0.012),
}


def variant(name: str) -> LmsModel:
    """
    Return a scanner type by name.

    Raises
    ------
    UsageError
        Naming the variants there are.

    """
    if name not in VARIANTS:
        raise UsageError(f'unknown scanner variant "{name}"; known are {", ".join(VARIANTS)}')
    return VARIANTS[name]
