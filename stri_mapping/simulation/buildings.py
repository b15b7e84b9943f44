# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A small grammar of town houses: storeys, bays, windows, doors, shops, columns, balconies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stri_mapping.simulation.mesh import Surface
from stri_mapping.simulation.site import Opening, Site

GROUND_FLOORS = ('windows', 'shop', 'arcade')


@dataclass(frozen=True)
class House:
    """
    What is drawn once for a house and holds for all of its front.

    Attributes
    ----------
    width, depth
        Metres along the street and away from it.
    bays, storeys
        Columns and rows of windows, the ground floor included.
    ground, storey
        Height of the ground floor and of each above, metres.
    window
        Width and height of a window, and its sill above the floor, metres.
    recess
        Metres from the wall's face back to the panes.
    floor
        Kind of ground floor, one of `GROUND_FLOORS`.
    pilaster
        How far the pillars between the bays stand out, metres; 0 for none.
    balcony
        How far balconies stand out, metres; 0 for none.
    stone
        Surface of the wall.

    """

    width: float
    depth: float
    bays: int
    storeys: int
    ground: float
    storey: float
    window: tuple[float, float, float]
    recess: float
    floor: str
    pilaster: float
    balcony: float
    stone: Surface

    @property
    def height(self) -> float:
        """Metres to the eaves."""
        return self.ground + (self.storeys - 1) * self.storey

    @property
    def bay(self) -> float:
        """Metres from one column of windows to the next."""
        return self.width / self.bays


def draw_house(site: Site, width: float) -> House:
    """Return a random house of a given width."""
    material = str(site.rng.choice(['plaster', 'plaster', 'brick', 'concrete', 'stone']))
    bays = max(1, round(width / site.uniform(2.6, 4.4)))
    storey = site.uniform(2.9, 3.4)
    window = (site.uniform(0.4, 0.62) * width / bays, site.uniform(1.3, 1.8),
              site.uniform(0.75, 1.0))
    return House(
        width, site.uniform(8.0, 12.0), bays, int(site.rng.integers(2, 7)),
        storey + site.uniform(0.2, 1.0), storey, window, site.uniform(0.08, 0.35),
        str(site.rng.choice(GROUND_FLOORS, p=(0.6, 0.28, 0.12))),
        site.uniform(0.12, 0.4) if site.chance(0.4) else 0.0,
        site.uniform(0.9, 1.3) if site.chance(0.35) else 0.0, site.paint(material))


def build_house(site: Site, house: House) -> None:
    """Add a house that begins at the site's origin, its face on y = 0."""
    upper = [_window(site, house, i, house.ground + k * house.storey)
             for k in range(house.storeys - 1) for i in range(house.bays)]
    if house.floor == 'arcade':
        _arcade(site, house)
        site.wall(0.0, 0.0, house.width, house.height, house.stone, upper, foot=house.ground)
    else:
        lower = _shop(site, house) if house.floor == 'shop' else _doors(site, house)
        site.wall(0.0, 0.0, house.width, house.height, house.stone, lower + upper)
    _shell(site, house)
    if house.pilaster > 0.0:
        _pilasters(site, house)
    if house.balcony > 0.0:
        _balconies(site, house)


def _pane(site: Site) -> tuple[float, Surface]:
    """Return how far behind the glass the light comes back, and from what."""
    kind = site.rng.random()
    if kind < 0.4:
        return 0.0, site.paint('glass')
    if kind < 0.75:
        return 0.05, site.paint('blind')
    return site.uniform(1.5, 3.0), site.paint('room')


def _window(site: Site, house: House, bay: int, floor: float) -> Opening:
    """Return one window of a bay of the storey whose floor is at height `floor`."""
    wide, high, sill = house.window
    middle = (bay + 0.5) * house.bay
    behind, pane = _pane(site)
    return Opening(middle - 0.5 * wide, middle + 0.5 * wide, floor + sill, floor + sill + high,
                   house.recess + behind, pane)


def _doors(site: Site, house: House) -> list[Opening]:
    """Return the windows and one or two doors of an ordinary ground floor."""
    openings = [_window(site, house, i, 0.0) for i in range(house.bays)]
    for i in site.rng.choice(house.bays, min(house.bays, int(site.rng.integers(1, 3))), False):
        middle, half = (i + 0.5) * house.bay, 0.5 * min(1.2, 0.8 * house.bay)
        openings[i] = Opening(middle - half, middle + half, 0.0, 2.2, site.uniform(0.15, 0.9),
                              site.paint('wood'))
    return openings


def _shop(site: Site, house: House) -> list[Opening]:
    """Return shop windows from bay to bay, pillars left between them."""
    pillar = site.uniform(0.25, 0.5)
    openings = []
    for i in range(house.bays):
        behind, pane = _pane(site)
        openings.append(Opening(i * house.bay + pillar, (i + 1) * house.bay - pillar,
                                site.uniform(0.1, 0.5), house.ground - 0.6,
                                house.recess + behind, pane))
    return openings


def _arcade(site: Site, house: House) -> None:
    """Add a ground floor that stands back behind columns."""
    back, half = min(2.4, 0.4 * house.depth), 0.5 * site.uniform(0.4, 0.6)
    site.wall(0.0, back, house.width, house.ground, house.stone, _doors(site, house))
    site.level((0.0, 0.0), (house.width, back), house.ground, house.stone)
    for x in np.linspace(half, house.width - half, house.bays + 1).tolist():
        site.box((x - half, 0.0, 0.0), (x + half, 2.0 * half, house.ground), house.stone)
        site.note('columns', x, half, side=2.0 * half)


def _shell(site: Site, house: House) -> None:
    """Add the side walls and the roof."""
    front = 2.4 if house.floor == 'arcade' else 0.0
    for x in (0.0, house.width):
        site.quads([[(x, front, 0.0), (x, house.depth, 0.0), (x, house.depth, house.ground),
                     (x, front, house.ground)],
                    [(x, 0.0, house.ground), (x, house.depth, house.ground),
                     (x, house.depth, house.height), (x, 0.0, house.height)]], house.stone)
    site.level((0.0, 0.0), (house.width, house.depth), house.height, site.paint('concrete'))


def _pilasters(site: Site, house: House) -> None:
    """Add pillars between the bays."""
    half = 0.5 * min(0.5, 0.35 * house.bay)
    foot = house.ground if house.floor == 'arcade' else 0.0
    for x in np.linspace(half, house.width - half, house.bays + 1).tolist():
        site.box((x - half, -house.pilaster, foot), (x + half, 0.0, house.height), house.stone)
        if foot == 0.0:
            site.note('pilasters', x, -0.5 * house.pilaster, side=2.0 * half)


def _balconies(site: Site, house: House) -> None:
    """Add a balcony to every bay of some columns of windows."""
    slab, rail = site.paint('concrete'), site.paint('metal')
    half = 0.45 * house.bay
    for i in range(int(site.rng.integers(0, 2)), house.bays, int(site.rng.integers(1, 4))):
        x = (i + 0.5) * house.bay
        for k in range(house.storeys - 1):
            z = house.ground + k * house.storey
            site.box((x - half, -house.balcony, z - 0.15), (x + half, 0.0, z), slab)
            site.box((x - half, -house.balcony, z), (x + half, -house.balcony + 0.06, z + 1.0),
                     rail)
