# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Straight runs in scan lines, and the classes that points get from them."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from numpy.typing import NDArray

from stri_mapping.facade.labels import label_line
from stri_mapping.facade.points import FACADE, GROUND, OTHER, VEGETATION
from stri_mapping.facade.scan_lines import (
    COUNT,
    DIR_T,
    DIR_V,
    find_runs,
    FIRST,
    LAST,
    LENGTH,
    RMS,
    RUN_FIELDS,
)

Array = NDArray[np.float64]
HEIGHT = 1.9


def runs_of(t: Array, v: Array) -> tuple[Array, NDArray[np.int32]]:
    runs, member = np.empty((len(t) + 1, RUN_FIELDS)), np.empty(len(t), np.int32)
    count = find_runs(t, v, runs, member)
    return runs[:count], member


def street_line(rng: np.random.Generator, noise: float = 0.01) -> tuple[Array, Array]:
    """Return one line of a scanner 1.9 m above a road, a car, a pavement and a wall 9 m away."""
    angles = np.deg2rad(np.arange(-90.0, 61.0))
    ranges = np.full(len(angles), np.inf)
    with np.errstate(divide='ignore'):
        down = np.where(angles < 0.0, -HEIGHT / np.sin(angles), np.inf)
        wall = 9.0 / np.cos(angles)
    ranges = np.minimum(down, wall)
    side = 5.0 / np.cos(angles)                  # a car's side, 5 m away and 0.3 to 1.4 m high
    high = 5.0 * np.tan(angles) + HEIGHT
    car = (high > 0.3) & (high < 1.4)
    ranges[car] = np.minimum(ranges, side)[car]
    ranges[wall * np.sin(angles) > 8.0] = np.inf
    ranges = ranges + rng.normal(0.0, noise, len(angles))
    hit = np.isfinite(ranges)
    return (ranges * np.cos(angles))[hit], (ranges * np.sin(angles))[hit]


def labels_of(t: Array, v: Array, remembered: Array | None = None) -> NDArray[np.uint8]:
    runs, member = runs_of(t, v)
    label = np.zeros(len(t), np.uint8)
    points = np.column_stack([0 * t, t + 0.6, v + HEIGHT])
    label_line(points, t, runs, member,
               np.full(4, np.inf) if remembered is None else remembered, label)
    return label


def test_road_car_and_wall_are_told_apart() -> None:
    t, v = street_line(np.random.default_rng(1))
    label, z = labels_of(t, v), v + HEIGHT
    wall = np.abs(t - 9.0) < 0.1
    assert np.mean(label[(z < 0.1) & (t < 4.5)] == GROUND) > 0.97
    assert np.mean(label[wall & (z > 0.5)] == FACADE) > 0.97
    assert np.mean(label[(np.abs(t - 5.0) < 0.1) & (z > 0.4) & (z < 1.3)] == OTHER) > 0.9


def side_line(away: float, low: float, high: float) -> tuple[Array, Array]:
    """Return a line of road, something upright `away` metres aside, and a wall 9 m away."""
    t, v = street_line(np.random.default_rng(4), noise=0.002)
    angles = np.arctan2(v, t)
    z = away * np.tan(angles) + HEIGHT
    hit = (z > low) & (z < high) & (t > away)
    return np.where(hit, away, t), np.where(hit, away * np.tan(angles), v)


def test_the_side_of_a_lorry_is_no_facade() -> None:
    remembered = np.full(4, np.inf)
    for low in (0.8, 0.0, 0.0):                  # the box, and then a wheel below it
        t, v = side_line(4.0, low, 4.0)
        label, box = labels_of(t, v, remembered), t == 4.0
        assert np.count_nonzero(box & (v + HEIGHT > 1.0)) > 20
        assert (label[box & (v + HEIGHT > 1.0)] == OTHER).all()
        assert (label[(np.abs(t - 9.0) < 0.1) & (v + HEIGHT > 4.0)] == FACADE).all()


def test_what_is_higher_than_a_lorry_or_stands_on_the_ground_is_a_facade() -> None:
    for low, high in ((0.8, 5.5), (0.0, 4.0)):
        t, v = side_line(4.0, low, high)
        label = labels_of(t, v)
        assert np.mean(label[(t == 4.0) & (v + HEIGHT > 1.0)] == FACADE) > 0.97


def test_leaves_are_no_facade() -> None:
    rng = np.random.default_rng(3)
    angles = np.deg2rad(np.arange(10.0, 60.0))
    ranges = rng.uniform(4.0, 6.0, len(angles))
    t, v = ranges * np.cos(angles), ranges * np.sin(angles)
    assert np.mean(labels_of(t, v) == VEGETATION) > 0.8


def test_a_hidden_facade_is_remembered_for_a_while() -> None:
    remembered = np.full(4, np.inf)
    labels_of(*street_line(np.random.default_rng(1)), remembered)
    t, v = np.full(2, 9.1), np.array([2.0, 4.2])         # bits of it, seen through a tree
    assert set(labels_of(t, v, remembered)) == {FACADE}
    for _ in range(100):
        label = labels_of(t, v, remembered)
    assert FACADE not in label


@given(st.floats(-np.pi, np.pi), st.floats(2.0, 30.0), st.integers(3, 100),
       st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_a_straight_line_is_one_run_of_its_own_direction(
        turn: float, away: float, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    along = np.arange(count) * 0.1
    off = rng.normal(0.0, 0.003, count)
    t = away * np.cos(turn) - along * np.sin(turn) + off * np.cos(turn)
    v = away * np.sin(turn) + along * np.cos(turn) + off * np.sin(turn)
    runs, member = runs_of(t, v)
    assert len(runs) == 1
    assert (runs[0, FIRST], runs[0, LAST], runs[0, COUNT]) == (0, count - 1, count)
    assert not member.any()
    assert abs(runs[0, LENGTH] - along[-1]) < 0.03
    assert runs[0, RMS] < 0.01
    if count > 10:                               # direction: 3 mm over a metre or more
        assert abs(runs[0, DIR_T] * np.cos(turn) + runs[0, DIR_V] * np.sin(turn)) < 0.02


@given(st.lists(st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)), max_size=60))
@settings(max_examples=100, deadline=None)
def test_every_point_is_in_one_run_or_in_none(points: list[tuple[float, float]]) -> None:
    t, v = np.array(points, dtype=float).reshape(-1, 2).T.copy()
    runs, member = runs_of(t, v)
    for q, run in enumerate(runs):
        own = np.flatnonzero(member == q)
        assert len(own) == run[COUNT] >= 3
        assert (own[0], own[-1]) == (run[FIRST], run[LAST])
    assert member.max(initial=-1) == len(runs) - 1
    label = labels_of(t, v)
    assert set(label) <= {OTHER, GROUND, VEGETATION, FACADE}
