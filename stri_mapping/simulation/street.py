# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A street of a town from a small seeded grammar: lots, pavements, trees, lamps, parked cars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stri_mapping.simulation.buildings import build_house, draw_house
from stri_mapping.simulation.furniture import hedge, lamp, road_vehicle, sign, tree, VEHICLES
from stri_mapping.simulation.site import Site

KERB = 0.12
# Metres behind the building line that belong to a lot: nothing is built further back.
LOT_DEPTH = 30.0


@dataclass(frozen=True)
class Profile:
    """
    Cross-section of a street, metres from the line that the vehicle drives along.

    Attributes
    ----------
    left, right
        To the building lines.
    pavement
        From kerb to building line.
    parking
        Width of the strip where cars stand, along each kerb.

    """

    left: float = 9.4
    right: float = 6.4
    pavement: float = 2.6
    parking: float = 2.1


def street(site: Site, length: float, profile: Profile = Profile(), left_from: float = 0.0,
           left_to: float = 0.0, right_from: float = 0.0, right_to: float = 0.0) -> None:
    """
    Add both sides of a straight street that runs along x from the site's origin.

    Parameters
    ----------
    site
        Its x axis is the line the vehicle drives along.
    length
        Metres.
    profile
        Cross-section.
    left_from, left_to, right_from, right_to
        By how much each side begins earlier (negative) or later, and ends later or earlier
        (negative) than the street: what a corner needs.

    """
    start, stop = left_from, length + left_to
    frontage(site.at(start, profile.left), stop - start, profile)
    start, stop = right_from, length + right_to
    frontage(site.at(stop, -profile.right, np.pi), stop - start, profile)


def frontage(site: Site, length: float, profile: Profile) -> None:
    """Add one side of a street: the building line is y = 0, the kerb at y = -pavement."""
    stone = site.paint('concrete')
    site.level((0.0, -profile.pavement), (length, LOT_DEPTH), KERB, stone)
    site.box((0.0, -profile.pavement, 0.0), (length, -profile.pavement + 0.15, KERB), stone)
    _lots(site, length)
    _trees_and_lamps(site, length, -profile.pavement + 0.55)
    _parked(site, length, -profile.pavement - 0.5 * profile.parking)


def _lots(site: Site, length: float) -> None:
    """Fill the building line from end to end, never with two openings side by side."""
    x, closed = 0.0, False
    while length - x > 4.0:
        kind = str(site.rng.choice(['house', 'gap', 'wall', 'hedge'], p=(0.74, 0.1, 0.08, 0.08)))
        if kind != 'house' and not closed:
            kind = 'house'
        low, high = {'house': (9.0, 22.0), 'gap': (4.0, 10.0)}.get(kind, (7.0, 18.0))
        width = site.uniform(low, high)
        if length - x - width < 7.0:
            width = length - x
        lot = site.at(x, site.uniform(0.0, 1.5) if site.chance(0.4) else 0.0)
        {'house': _house, 'gap': _gap, 'wall': _garden_wall, 'hedge': _hedge}[kind](lot, width)
        x, closed = x + width, kind == 'house'


def _house(lot: Site, width: float) -> None:
    build_house(lot, draw_house(lot, width))


def _gap(lot: Site, width: float) -> None:
    """Add a yard or a side street: only something far back closes it."""
    lot.wall(0.0, lot.uniform(12.0, LOT_DEPTH), width, lot.uniform(3.0, 9.0),
             lot.paint('plaster'))


def _garden_wall(lot: Site, width: float) -> None:
    """Add a bare wall, thick enough to have a top."""
    height, brick = lot.uniform(1.8, 2.8), lot.paint('brick')
    lot.wall(0.0, 0.0, width, height, brick)
    lot.box((0.0, 0.001, 0.0), (width, 0.3, height), brick)


def _hedge(lot: Site, width: float) -> None:
    hedge(lot, 0.0, 0.2, width)


def _trees_and_lamps(site: Site, length: float, y: float) -> None:
    """Add a row of trees, or none, and lamps and signs between them."""
    spacing = site.uniform(8.0, 16.0)
    row = site.chance(0.6)
    for i, x in enumerate(np.arange(site.uniform(2.0, 8.0), length - 2.0, spacing).tolist()):
        if row and site.chance(0.85):
            tree(site, x + site.uniform(-0.5, 0.5), y)
        if i % 2 == 0:
            lamp(site, x + 0.5 * spacing, y)
        if site.chance(0.15):
            sign(site, x + 0.25 * spacing, y)


def _parked(site: Site, length: float, y: float) -> None:
    """Add parked cars, none within 8 m of the ends."""
    x, share = 8.0, site.uniform(0.25, 0.8)
    while x < length - 8.0:
        if site.chance(share):
            yaw = (0.0 if site.chance(0.8) else np.pi) + site.uniform(-0.03, 0.03)
            kind = str(site.rng.choice(VEHICLES))
            long = 8.0 if kind == 'truck' else 5.0
            road_vehicle(site.at(x + 0.5 * long, y + site.uniform(-0.15, 0.15), yaw), kind)
            site.note('parked', x + 0.5 * long, y, what=kind)
            x += long + site.uniform(0.7, 1.5)
        else:
            x += site.uniform(3.0, 8.0)
