# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What stands along a street, and what drives and walks in it, by shape."""

from __future__ import annotations

import numpy as np

from stri_mapping import geometry
from stri_mapping.simulation.mesh import circle, Mesh, MeshBuilder
from stri_mapping.simulation.site import Site

VEHICLES = ('car', 'car', 'car', 'car', 'estate', 'van', 'truck')


def tree(site: Site, x: float, y: float) -> None:
    """Add a trunk and a crown of loose leaves that light passes between."""
    radius, stem = site.uniform(0.10, 0.25), site.uniform(2.2, 3.4)
    site.post(x, y, radius, 0.0, stem + 1.5, site.paint('bark'))
    count, rng = 160, site.rng
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    size = np.array([site.uniform(1.2, 2.2), site.uniform(1.2, 2.2), site.uniform(1.4, 2.6)])
    middle = (x, y, stem + size[2]) + size * direction * rng.random((count, 1)) ** 0.4
    across = np.cross(direction, rng.standard_normal((count, 3)))
    across *= rng.uniform(0.15, 0.4, (count, 1)) / np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(direction, across)
    leaves = np.stack([middle - across, middle - along, middle + across, middle + along], 1)
    site.quads(leaves, site.paint('leaves'))
    site.note('trees', x, y, radius=radius)


def lamp(site: Site, x: float, y: float) -> None:
    """Add a lamp post with an arm towards the road."""
    height, metal = site.uniform(5.5, 8.0), site.paint('metal')
    radius = site.uniform(0.05, 0.09)
    site.post(x, y, radius, 0.0, height, metal)
    site.box((x - 0.1, y - 1.4, height - 0.15), (x + 0.1, y, height), metal)
    site.note('lamps', x, y, radius=radius)


def sign(site: Site, x: float, y: float) -> None:
    """Add a traffic sign that drivers along the street face."""
    site.post(x, y, 0.035, 0.0, 2.8, site.paint('metal'))
    site.box((x - 0.01, y - 0.3, 2.2), (x + 0.01, y + 0.3, 2.8), site.paint('reflector'))
    site.note('signs', x, y, radius=0.035)


def hedge(site: Site, x: float, y: float, length: float) -> None:
    """Add a hedge whose face is never flat."""
    height, leaves = site.uniform(1.3, 2.4), site.paint('leaves')
    edges = np.linspace(0.0, length, max(2, round(length / 0.25)) + 1)
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist()):
        site.box((x + begin, y - site.uniform(0.0, 0.18), 0.0),
                 (x + end, y + 0.8, height + site.uniform(-0.1, 0.1)), leaves)


def road_vehicle(site: Site, kind: str) -> None:
    """Add a car, estate, van, truck or bus, its middle at the origin, heading along x."""
    if kind in ('car', 'estate'):
        _car(site, kind == 'estate')
        return
    length, width, low, height = {
        'van': (site.uniform(4.8, 5.6), 1.95, 0.35, site.uniform(1.95, 2.5)),
        'truck': (site.uniform(6.5, 8.5), 2.4, 0.6, site.uniform(2.9, 3.5)),
        'bus': (12.0, 2.55, 0.35, 3.1)}[kind]
    half = 0.5 * length
    body = site.paint('paint')
    site.box((-half, -0.5 * width, low), (half, 0.5 * width, height), body)
    if kind == 'bus':
        glass = site.paint('glass')
        for side in (-1.0, 1.0):
            y = side * (0.5 * width + 0.005)
            site.quads([[(-half + 0.5, y, 1.4), (half - 0.8, y, 1.4), (half - 0.8, y, 2.4),
                         (-half + 0.5, y, 2.4)]], glass)
    _wheels(site, length, width, 0.45)


def _car(site: Site, estate: bool) -> None:
    """Add a car: body, greenhouse with sloping ends, wheels and plates."""
    length, width = site.uniform(3.9, 4.7), site.uniform(1.65, 1.85)
    half, waist, roof = 0.5 * length, site.uniform(0.82, 0.95), site.uniform(1.38, 1.55)
    body, glass = site.paint('paint'), site.paint('glass')
    site.box((-half, -0.5 * width, 0.22), (half, 0.5 * width, waist), body)
    front, rear = 0.22 * length, -half + (0.05 if estate else 0.16 * length)
    outline = np.array([(rear, waist), (front, waist), (front - 0.75, roof - 0.03),
                        (rear + (0.15 if estate else 0.65), roof - 0.03)])
    # the outline lies in x-z: a prism along y, its local z being -y
    upright = geometry.transform((0.0, 0.0, 0.0), (0.5 * np.pi, 0.0, 0.0))
    site.builder.prism(outline, -0.46 * width, 0.46 * width, glass, site.T_odom_site @ upright)
    site.box((rear + 0.65, -0.45 * width, roof - 0.04), (front - 0.75, 0.45 * width, roof), body)
    for x in (-half - 0.01, half + 0.01):
        site.quads([[(x, -0.26, 0.45), (x, 0.26, 0.45), (x, 0.26, 0.56), (x, -0.26, 0.56)]],
                   site.paint('reflector'))
    _wheels(site, length, width, 0.31)


def _wheels(site: Site, length: float, width: float, radius: float) -> None:
    """Add four wheels that show at the sides."""
    rubber = site.paint('rubber')
    upright = geometry.transform((0.0, 0.0, 0.0), (0.5 * np.pi, 0.0, 0.0))
    for x in (-0.31 * length, 0.31 * length):
        for y in (-0.5 * width - 0.01, 0.5 * width - 0.19):
            site.builder.prism(circle(x, radius, radius), y, y + 0.2, rubber,
                               site.T_odom_site @ upright)


def pedestrian(site: Site) -> None:
    """Add a person at the origin who walks along x."""
    cloth = site.paint('cloth')
    stride = site.uniform(0.1, 0.3)
    for x, y in ((-stride, -0.1), (stride, 0.1)):
        site.post(x, y, 0.08, 0.12, 0.85, cloth)
    site.post(0.0, 0.0, site.uniform(0.18, 0.24), 0.8, 1.45, cloth)
    site.post(0.0, 0.0, 0.1, 1.45, site.uniform(1.65, 1.85), site.paint('wood'))


def shape(rng: np.random.Generator, kind: str) -> Mesh:
    """Return a pedestrian or vehicle by kind, in its own frame."""
    site = Site(MeshBuilder(), rng, {}, np.eye(4))
    if kind == 'pedestrian':
        pedestrian(site)
    else:
        road_vehicle(site, kind)
    return site.builder.mesh()
