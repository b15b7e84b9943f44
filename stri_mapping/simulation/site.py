# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""A stretch of ground to build on: walls with openings, boxes, posts, in its own frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stri_mapping import geometry
from stri_mapping.simulation.materials import paint
from stri_mapping.simulation.mesh import circle, MeshBuilder, moved, Surface

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Opening:
    """
    A rectangle cut into a wall and closed again further back.

    Attributes
    ----------
    left, right, bottom, top
        Metres along and up the wall.
    depth
        Metres from the wall's face back to the pane; negative where it stands out.
    pane
        Surface of the pane; None leaves the opening open.

    """

    left: float
    right: float
    bottom: float
    top: float
    depth: float
    pane: Surface | None


@dataclass(frozen=True, eq=False)
class Site:
    """
    Where one builds: x along the street, y away from it, z up, metres.

    Attributes
    ----------
    builder
        Takes the triangles.
    rng
        Draws what is random.
    facts
        Takes what people and tests may want to know, by kind, in odom.
    T_odom_site
        (4, 4) transform.

    """

    builder: MeshBuilder
    rng: np.random.Generator
    facts: dict[str, Any]
    T_odom_site: Array

    def at(self, x: float, y: float, yaw: float = 0.0) -> Site:
        """Return the site whose origin is at (x, y) of this one, turned by yaw."""
        T = self.T_odom_site @ geometry.transform((x, y, 0.0), (0.0, 0.0, yaw))
        return Site(self.builder, self.rng, self.facts, T)

    def paint(self, material: str) -> Surface:
        """Return the surface of one object of a material."""
        return paint(material, self.rng)

    def uniform(self, low: float, high: float) -> float:
        """Return a random number between two limits."""
        return float(self.rng.uniform(low, high))

    def chance(self, probability: float) -> bool:
        """Return True with the given probability."""
        return bool(self.rng.random() < probability)

    def note(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Remember in the facts, under its kind, that something stands at (x, y)."""
        px, py, _ = moved(np.array([x, y, 0.0]), self.T_odom_site)
        self.facts.setdefault(kind, []).append(
            {'x': round(float(px), 4), 'y': round(float(py), 4), **more})

    def box(self, low: ArrayLike, high: ArrayLike, surface: Surface) -> None:
        """Add a box between two corners (x, y, z)."""
        self.builder.box(low, high, surface, self.T_odom_site)

    def quads(self, corners: ArrayLike, surface: Surface) -> None:
        """Add quadrilaterals (..., 4, 3)."""
        self.builder.quads(moved(np.asarray(corners, dtype=float), self.T_odom_site), surface)

    def post(self, x: float, y: float, radius: float, low: float, high: float,
             surface: Surface) -> None:
        """Add an upright cylinder."""
        self.builder.prism(circle(x, y, radius), low, high, surface, self.T_odom_site)

    def level(self, low: ArrayLike, high: ArrayLike, z: float, surface: Surface) -> None:
        """Add a level rectangle between two corners (x, y) at height z."""
        (x0, y0), (x1, y1) = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        self.quads([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)], surface)

    def wall(self, x: float, y: float, length: float, height: float, surface: Surface,
             openings: Sequence[Opening] = (), foot: float = 0.0) -> None:
        """
        Add a wall whose face looks at the street, with openings.

        Parameters
        ----------
        x, y
            Where it begins; it runs along x.
        length, height
            Metres; it stands from z = `foot` to `height`.
        surface
            Of the wall and of the openings' sides.
        openings
            Measured from where the wall begins; they may share edges but not overlap.
        foot
            Metres.

        """
        T = self.T_odom_site @ geometry.transform((x, y, 0.0), (0.0, 0.0, 0.0))
        self.builder.quads(moved(_solid(length, height, openings, foot), T), surface)
        for o in openings:
            self.builder.quads(moved(_sides(o), T), surface)
            if o.pane is not None:
                pane = _upright(o.left, o.right, o.bottom, o.top, o.depth)
                self.builder.quads(moved(pane, T), o.pane)
        ends = moved(np.array([(0.0, 0.0, 0.0), (length, 0.0, 0.0)]), T)
        self.facts.setdefault('walls', []).append({
            'from': ends[0, :2].round(4).tolist(), 'to': ends[1, :2].round(4).tolist(),
            'foot': foot, 'height': height, 'material': surface.name})


def _solid(length: float, height: float, openings: Sequence[Opening], foot: float) -> Array:
    """Return the rectangles (..., 4, 3) of a wall's face that no opening takes."""
    x = np.unique([0.0, length, *(v for o in openings for v in (o.left, o.right))])
    z = np.unique([foot, height, *(v for o in openings for v in (o.bottom, o.top))])
    solid = np.ones((len(x) - 1, len(z) - 1), dtype=bool)
    for o in openings:
        solid[np.searchsorted(x, o.left):np.searchsorted(x, o.right),
              np.searchsorted(z, o.bottom):np.searchsorted(z, o.top)] = False
    i, j = np.nonzero(solid)
    return _upright(x[i], x[i + 1], z[j], z[j + 1])


def _upright(left: ArrayLike, right: ArrayLike, bottom: ArrayLike, top: ArrayLike,
             y: float = 0.0) -> Array:
    """Return rectangles (..., 4, 3) that face -y."""
    left, right, bottom, top = (np.asarray(v, dtype=float) for v in (left, right, bottom, top))
    corners = [(left, bottom), (right, bottom), (right, top), (left, top)]
    return np.stack([np.stack([a, np.full(a.shape, y), c], -1) for a, c in corners], -2)


def _sides(o: Opening) -> Array:
    """Return the four sides (4, 4, 3) between the wall's face and the pane."""
    rim = np.array([(o.left, o.bottom), (o.right, o.bottom), (o.right, o.top), (o.left, o.top)])
    face, pane = (np.insert(rim, 1, y, axis=1) for y in (0.0, o.depth))
    return np.stack([face, np.roll(face, -1, 0), np.roll(pane, -1, 0), pane], 1)
