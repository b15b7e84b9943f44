# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator on slow scanners that look ahead, as robots in buildings have them."""

import numpy as np
import pytest
from test_stri_estimator import run
from test_stri_parts import ANGLES, look

from stri_mapping.scan import Scan
from stri_mapping.stri.pairs import TANGENT

PERIOD, SPEED, SECONDS = 0.2, 0.5, 20.0
NOISE = 0.01


def corridor():
    """Walls (n, 4) of a corridor 2.2 m wide, a pilaster now on the one side, now on the other."""
    walls = [(-30.0, y, 90.0, y) for y in (-1.1, 1.1)]
    for k, x in enumerate(np.arange(-28.0, 90.0, 10.0)):
        outer = 1.1 if k % 2 == 0 else -1.1
        inner = 0.85 * np.sign(outer)
        walls += [(x, outer, x, inner), (x, inner, x + 0.3, inner),
                  (x + 0.3, inner, x + 0.3, outer)]
    return walls


@pytest.mark.parametrize('seed', range(4))
def test_the_way_along_a_corridor_is_told_by_faces_that_few_rays_meet(seed):
    rng = np.random.default_rng(seed)
    walls, scans = corridor(), []
    times = np.arange(0.0, SECONDS, PERIOD)
    for t in times:
        pose = np.array([SPEED * t, 0.0, np.deg2rad(3.0) * np.sin(t)])
        ranges = np.round(look(pose, walls, NOISE, rng), 2)
        scans.append(Scan(round(1e9 * t), ranges, ANGLES, np.zeros(len(ANGLES)), range_max=80.0))
    _, final = run(np.eye(4), scans)
    way = np.array([e.pose[0] for e in final])
    # 5 to 10 m ahead one or two rays meet a pilaster; it is found again within TANGENT.  The
    # walls alone would let the fit stand still, 10 m off
    assert np.abs(way - SPEED * times).max() < TANGENT
