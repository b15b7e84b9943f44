# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A fast road where little stands: guard rails, lamps, bridge piers, trees, noise barriers."""

from __future__ import annotations

import numpy as np

from stri_mapping.simulation.furniture import lamp, tree
from stri_mapping.simulation.site import Site

# Metres to the left of the lane driven in: middle of the median, far edge, first trees.
MEDIAN, EDGE, TREES = 7.0, 16.5, 20.0


def highway(site: Site, begin: float, end: float) -> None:
    """Add a straight dual carriageway along x between two x, the vehicle's lane on y = 0."""
    site.level((begin - 60, -8.0), (end + 60, EDGE), 0.0, site.paint('asphalt'))
    grass = site.paint('grass')
    site.level((begin - 60, EDGE), (end + 60, 70.0), -0.2, grass)
    site.level((begin - 60, -70.0), (end + 60, -8.0), -0.2, grass)
    for y in (MEDIAN - 0.6, MEDIAN + 0.6, EDGE - 0.5, -6.0):
        _guard_rail(site, begin, end, y)
    for x in np.arange(begin + site.uniform(0.0, 40.0), end, 45.0).tolist():
        lamp(site, x, MEDIAN)
    for x in np.arange(begin + site.uniform(30.0, 150.0), end, 210.0).tolist():
        _bridge(site, x)
    _roadside(site, begin, end)


def _guard_rail(site: Site, begin: float, end: float, y: float) -> None:
    """Add a rail 0.75 m high on posts every 4 m."""
    metal = site.paint('metal')
    site.box((begin, y - 0.03, 0.45), (end, y + 0.03, 0.75), metal)
    for x in np.arange(begin, end, 4.0).tolist():
        site.box((x - 0.03, y, 0.0), (x + 0.03, y + 0.12, 0.7), metal)


def _bridge(site: Site, x: float) -> None:
    """Add a bridge over the road on piers."""
    concrete, half = site.paint('concrete'), site.uniform(3.0, 6.0)
    site.box((x - half, -20.0, 5.2), (x + half, EDGE + 14.0, 6.4), concrete)
    for y in (-9.0, MEDIAN, EDGE + 3.0):
        for pier in (x - 0.7 * half, x + 0.7 * half):
            site.box((pier - 0.5, y - 0.5, -0.2), (pier + 0.5, y + 0.5, 5.2), concrete)
            site.note('piers', pier, y, side=1.0)


def _roadside(site: Site, begin: float, end: float) -> None:
    """Line the far side with trees, stretches of noise barrier, and stretches of nothing."""
    x = begin
    while x < end:
        length = site.uniform(40.0, 110.0)
        kind = str(site.rng.choice(['trees', 'barrier', 'nothing'], p=(0.5, 0.25, 0.25)))
        if kind == 'trees':
            for offset in np.arange(0.0, length, site.uniform(9.0, 20.0)).tolist():
                tree(site, x + offset, TREES + site.uniform(0.0, 4.0))
        elif kind == 'barrier':
            _barrier(site, x, min(length, end - x))
        x += length


def _barrier(site: Site, x: float, length: float) -> None:
    """Add a noise barrier: panels between posts every 4 m."""
    y, height, metal = EDGE + 2.0, site.uniform(2.5, 4.0), site.paint('metal')
    site.wall(x, y, length, height, site.paint('wood'), foot=-0.2)
    for post in np.arange(x, x + length, 4.0).tolist():
        site.box((post - 0.1, y - 0.15, -0.2), (post + 0.1, y, height + 0.1), metal)
