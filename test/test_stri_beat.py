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
    # once the scatter is known, the whole is late by where a tenth of what is late and half of
    # what is early are in balance, and keeps being so
    balance = 0.2 / (1.0 + 5.0 ** 0.5)      # 0.1 (0.2 - x)^2 = 0.5 x^2
    assert np.abs(times[60:] - true[60:] - balance).max() < 0.06
    # no step is off by more than half of the earliest stamp, few by as much, where the stamps'
    # own steps go from nothing to twice the period
    steps = np.diff(times[60:])
    assert np.abs(steps - PERIOD).max() < 0.5 * (balance + 0.06)
    assert np.std(steps) < 0.25 * np.std(np.diff(stamps[60:]))


@pytest.mark.parametrize('seed', range(5))
def test_a_logger_that_stalls_loses_no_scan(seed):
    rng = np.random.default_rng(seed)
    true = PERIOD * np.arange(1500)
    stamps = true + rng.uniform(0.0, 0.1, len(true))
    for start in np.arange(30.0, 230.0, 10.0):      # what waits is stamped when the stall ends
        end = start + rng.uniform(0.6, 3.0)
        stamps[(true > start) & (true < end)] = end
    times = beat(np.maximum.accumulate(stamps))
    # stalls count as lost scans until one has lasted as long: at the latest the longest
    known = np.searchsorted(true, 200.0)
    assert np.abs(times[known:] - true[known:]).max() < PERIOD
    assert np.abs(np.diff(times[known:]) - PERIOD).max() < 0.5 * PERIOD
    assert np.abs(stamps[known:] - true[known:]).max() > 5.0 * PERIOD


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
