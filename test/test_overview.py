# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The thinned copy for viewers: one point a voxel, whatever the order and the pieces."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np

from stri_mapping.facade.overview import Overview

clouds = arrays(float, st.tuples(st.integers(0, 40), st.just(3)),
                elements=st.floats(-50.0, 50.0))


def voxels(xyz: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(v) for v in np.floor(xyz / 0.2).astype(int).tolist()}


@given(st.lists(clouds, max_size=5))
def test_every_voxel_that_was_hit_has_exactly_its_first_point(pieces):
    overview = Overview(0.2)
    for piece in pieces:
        overview.add(piece)
    everything = np.concatenate([np.empty((0, 3)), *pieces])
    kept = overview.points()
    assert len(kept) == len(overview) == len(voxels(everything)) == len(voxels(kept))
    firsts = {}
    for point in everything.tolist():
        firsts.setdefault(tuple(np.floor(np.array(point) / 0.2).astype(int)), point)
    assert sorted(kept.tolist()) == sorted(firsts.values())
