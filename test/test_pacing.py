# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""When a recording's moments are due: rates, pauses and steps, on a clock of the test's own."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
import pytest

from stri_mapping.pacing import Pacer


class Clock:
    """Seconds that pass when told to."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@given(rate=st.floats(0.1, 100.0), passed=st.floats(0.0, 100.0), moment=st.floats(0.0, 1e4))
def test_a_moment_is_due_when_it_has_come_at_the_rate(rate, passed, moment):
    clock = Clock()
    pacer = Pacer(rate, clock)
    clock.now += passed
    left = pacer.wait(moment)
    assert left >= 0.0
    clock.now += left
    assert pacer.moment == pytest.approx(max(moment, passed * rate), rel=1e-9, abs=1e-6)
    assert pacer.wait(moment) == pytest.approx(0.0, abs=1e-6)


@given(rates=st.lists(st.tuples(st.floats(0.1, 10.0), st.floats(0.0, 10.0)), max_size=5))
def test_a_change_of_rate_jumps_nowhere(rates):
    clock = Clock()
    pacer = Pacer(1.0, clock)
    expected = 0.0
    for rate, seconds in rates:
        pacer.rate = rate
        assert pacer.moment == pytest.approx(expected)
        clock.now += seconds
        expected += rate * seconds
    assert pacer.moment == pytest.approx(expected)


def test_rate_0_waits_for_nothing():
    assert Pacer(0.0, Clock()).wait(1e9) == 0.0


def test_a_pause_stops_time_and_a_step_lets_one_message_pass():
    clock = Clock()
    pacer = Pacer(2.0, clock)
    clock.now += 1.0
    pacer.pause(True)
    clock.now += 50.0
    assert pacer.moment == pytest.approx(2.0)
    assert pacer.wait(0.0) == float('inf')
    pacer.step()
    assert pacer.wait(7.0) == 0.0
    pacer.passed(7.0)
    assert pacer.wait(7.0) == float('inf')
    pacer.pause(False)                      # on from what was played last
    assert pacer.wait(9.0) == pytest.approx(1.0)


def test_it_begins_where_it_is_told():
    pacer = Pacer(1.0, Clock())
    pacer.begin(30.0)
    assert pacer.wait(31.5) == pytest.approx(1.5)
