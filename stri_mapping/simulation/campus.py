# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's own test site: a wall with recessed windows behind columns that stand every 6 m."""

from __future__ import annotations

import numpy as np

from stri_mapping.simulation.mesh import Surface
from stri_mapping.simulation.site import Opening, Site

# Metres: spacing and side of the columns, y of their middles and of the wall, height of both.
SPACING, SIDE, COLUMNS_Y, WALL_Y, HEIGHT = 6.0, 0.6, 6.6, 8.6, 8.0
KERB_Y, KERB = 3.6, 0.12
# Windows of each storey: (bottom, top), their width and how far back they are.
STOREYS, WIDTH, RECESS = ((0.9, 2.7), (4.2, 6.0)), 2.4, 0.3


def campus(site: Site) -> None:
    """Add columns and wall along a drive of 170 m on y = 0."""
    _ground(site, -51.0, 225.0)
    _arcade(site, -51.0, 46)


def bare_wall(site: Site) -> None:
    """Add columns, 93 m of bare wall from x = 57 m on, and columns again."""
    _ground(site, -51.0, 258.0)
    _arcade(site, -51.0, 18)
    site.wall(57.0, WALL_Y, 93.0, HEIGHT, site.paint('plaster'))
    _arcade(site, 150.0, 18)


def _ground(site: Site, begin: float, end: float) -> None:
    """Add road, kerb and pavement."""
    low, high = begin - 60.0, end + 60.0
    site.level((low, -60.0), (high, KERB_Y), 0.0, site.paint('asphalt'))
    pavement = site.paint('concrete')
    site.level((low, KERB_Y), (high, WALL_Y + 0.5), KERB, pavement)
    site.box((low, KERB_Y, 0.0), (high, KERB_Y + 0.15, KERB), pavement)


def _arcade(site: Site, x: float, bays: int) -> None:
    """Add bays of 6 m, each a column in its middle and windows in the wall behind."""
    stone = [site.paint('stone') for _ in range(4)]
    glass, blind = site.paint('glass'), site.paint('blind')
    length = bays * SPACING
    middles = (np.arange(bays) + 0.5) * SPACING
    between = (np.arange(bays - 1) + 1.0) * SPACING
    site.wall(x, WALL_Y, length, HEIGHT, site.paint('brick'),
              [_window(m, storey, glass if site.chance(0.3) else blind)
               for m in between for storey in STOREYS])
    half = 0.5 * SIDE
    for i, m in enumerate(x + middles):
        site.box((m - half, COLUMNS_Y - half, 0.0), (m + half, COLUMNS_Y + half, HEIGHT),
                 stone[i % len(stone)])
        site.note('columns', float(m), COLUMNS_Y, side=SIDE)
    # the beam that the columns carry closes the arcade above
    site.box((x, COLUMNS_Y - half, 6.8), (x + length, COLUMNS_Y + half, HEIGHT),
             site.paint('concrete'))


def _window(middle: float, storey: tuple[float, float], pane: Surface) -> Opening:
    return Opening(middle - 0.5 * WIDTH, middle + 0.5 * WIDTH, *storey, RECESS, pane)
