# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The scanner's beat behind jittery stamps."""

import numpy as np
import pytest

from stri_mapping.stri.beat import Beat

PERIOD = 0.16


def beat(stamps):
    clock = Beat()
    return np.array([clock.add(t) for t in stamps])


def test_regular_stamps_are_taken_as_they_are():
    # a driver's own clock leaves a tenth of a millisecond; the mirror may drift
    rng = np.random.default_rng(1)
    stamps = np.cumsum(np.full(3000, 0.01332 * 1.0001)) + rng.normal(0.0, 1e-4, 3000)
    np.testing.assert_array_equal(beat(stamps), stamps)


def test_lost_scans_leave_regular_stamps_as_they_are():
    stamps = np.delete(0.01332 * np.arange(2000), [300, 301, 302, 900])
    np.testing.assert_array_equal(beat(stamps), stamps)


def test_late_stamps_are_put_on_the_beat():
    rng = np.random.default_rng(2)
    true = PERIOD * np.arange(400)
    stamps = np.maximum.accumulate(true + rng.uniform(0.0, 0.2, 400))
    times = beat(stamps)
    # once the scatter is known, steps are the period's but for a tenth of a stamp's lateness
    # (uniform over 0.2 s), where the stamps' own go from nothing to twice the period
    steps = np.diff(times[60:])
    assert np.abs(steps - PERIOD).max() < 0.1 * 0.2 + 0.005
    assert np.abs(np.diff(stamps[60:]) - PERIOD).max() > 0.15
    # the whole is late by the mean lateness, 0.1 s, and keeps being so
    assert np.abs(times[60:] - true[60:] - 0.1).max() < 0.06


def test_lost_scans_are_gaps_in_the_beat():
    rng = np.random.default_rng(3)
    true = np.delete(PERIOD * np.arange(300), np.arange(150, 160))
    times = beat(np.maximum.accumulate(true + rng.uniform(0.0, 0.15, len(true))))
    assert times[150] - times[149] == pytest.approx(11 * PERIOD, abs=PERIOD)


@pytest.mark.parametrize('seed', range(5))
def test_time_never_turns_back(seed):
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.choice([0.0, 0.001, 0.1, 0.4, 3.0], 1000, p=[0.1, 0.3, 0.3, 0.2, 0.1]))
    assert (np.diff(beat(stamps)) >= 0.0).all()
