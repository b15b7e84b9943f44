# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The mirror as a clock: true times from late arrivals, with and without real-time indices."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from stri_mapping.lms import stamps
from stri_mapping.lms.answers import decode_answer
from stri_mapping.lms.clock import lowest_line, MirrorClock, SETTLED, TURN_NS
from stri_mapping.lms.measuring import measuring_mode
from stri_mapping.lms.models import identify
from stri_mapping.lms.parser import Parser, Received
from stri_mapping.lms.samples import Indices, Samples, Scan
from stri_mapping.lms.stream import make_stream

MS = 1_000_000
# The longest buffering of a common adapter, and how often the tests let it happen.
BURST, BURSTS = 16 * MS, 0.02


class Observed:
    """What a clock made of a mirror's telegrams."""

    def __init__(self, seconds: float, ppm: float = 100.0, jitter: float = 5 * MS, stride: int = 1,
                 lost: float = 0.0, drift: float = 0.0, indexed: bool = True,
                 noted: bool = True, seed: int = 0) -> None:
        """Let a mirror, `ppm` too slow and slowing by `drift` ppm a minute, turn for a time."""
        rng = np.random.default_rng(seed)
        turns = np.arange(0, int(seconds / 13.32e-3), stride)
        nominal = turns * float(TURN_NS)
        true = 10**15 + nominal * (1 + 1e-6 * ppm) + 0.5e-6 * drift / 60e9 * nominal**2
        late = rng.uniform(0.0, jitter, len(turns)) + BURST * (rng.random(len(turns)) < BURSTS)
        arrivals = np.maximum.accumulate(true + late)       # bytes do not overtake one another
        kept = rng.random(len(turns)) >= lost
        self.clock = MirrorClock(stride)
        self.missing = int(np.count_nonzero(~kept))
        times, self.seconds, last = [], [], -stride
        errors = []
        for turn in turns[kept]:
            k = turn // stride
            gap, last = turn - last > stride and noted, turn
            time = self.clock.observe(int(arrivals[k]), int(turn) % 256 if indexed else None, gap)
            if time is not None:
                times.append(time)
                errors.append(time - true[k])
                self.seconds.append((true[k] - 1e15) * 1e-9)
        self.times, self.errors = np.array(times), np.array(errors) / MS

    def rms(self, begin: float, end: float = np.inf) -> float:
        """Return the root mean square error in milliseconds of a stretch of time."""
        chosen = (np.array(self.seconds) >= begin) & (np.array(self.seconds) < end)
        return float(np.sqrt(np.mean(self.errors[chosen]**2)))


@pytest.mark.parametrize('ppm', [100.0, -100.0])
def test_ten_minutes_of_jitter_and_bursts_leave_a_tenth_of_a_millisecond_and_no_drift(ppm):
    observed = Observed(600.0, ppm)
    # of 16 arrivals the most timely is late by 5 ms / 17 on average, and a hull over 94 such is
    # carried by its lowest ones: some 0.03 ms; the product's bound is 0.3
    assert observed.rms(5.0) < 0.1
    assert observed.rms(540.0) < 0.1
    assert abs(observed.clock.turn_ns / TURN_NS - 1.0 - 1e-6 * ppm) < 5e-6
    assert (observed.clock.lost, observed.clock.restarts) == (0, 0)
    assert np.all(np.diff(observed.times) > 0)
    assert observed.clock.arrival_jitter.rms > 2 * MS
    assert observed.clock.fit_jitter.rms < 0.02 * MS


def test_a_mirror_that_slows_down_is_followed():
    # 20 ppm a minute bends the line over 20 s by 20e-6 / 60 * 20^2 / 2 s = 0.07 ms
    assert Observed(300.0, drift=20.0).rms(5.0) < 0.15


@pytest.mark.parametrize('ppm', [-4000.0, 4000.0])
def test_a_mirror_far_from_its_nominal_speed_is_followed(ppm):
    assert Observed(60.0, ppm).rms(10.0) < 0.1


def test_a_slow_line_with_every_eighth_turn_is_followed():
    # an eighth of the telegrams, and minima of one or two each
    assert Observed(120.0, stride=8).rms(5.0) < 0.3


@pytest.mark.parametrize('indexed', [True, False])
def test_lost_scans_are_counted_and_cost_no_accuracy(indexed):
    observed = Observed(200.0, lost=0.01, indexed=indexed)
    assert observed.clock.lost == observed.missing > 100
    assert observed.rms(5.0) < 0.1
    assert np.all(np.diff(observed.times) > 0)


def test_losses_that_meet_bursts_are_counted_wrongly_for_a_moment_only():
    observed = Observed(200.0, lost=0.05, indexed=False)
    assert observed.clock.lost == observed.missing > 600
    assert np.mean(np.abs(observed.errors) > 1.0) < 0.01
    assert np.all(np.diff(observed.times) >= 0)     # of equal times, one is published


def test_losses_that_leave_no_trace_are_seen_by_the_times_alone():
    # with little jitter a telegram that is a turn late shows that one is missing
    observed = Observed(100.0, jitter=MS, lost=0.01, indexed=False, noted=False)
    assert abs(observed.clock.lost - observed.missing) <= 0.1 * observed.missing
    assert np.sqrt(np.median(observed.errors**2)) < 0.1


def test_an_index_that_comes_again_gives_no_second_time():
    clock = MirrorClock()
    times = [clock.observe(k * TURN_NS, k % 256) for k in range(100)]
    assert clock.observe(99 * TURN_NS + MS, 99) is None
    assert clock.observe(98 * TURN_NS + MS, 98) is None
    assert times[:SETTLED] == [None] * SETTLED
    assert None not in times[SETTLED:]


def test_a_gap_longer_than_the_index_counts_is_bridged():
    clock = MirrorClock()
    for k in range(500):
        clock.observe(k * TURN_NS, k % 256)
    for k in (500 + 1000, 500 + 1001):
        assert clock.observe(k * TURN_NS + 3 * MS, k % 256) == pytest.approx(k * TURN_NS, abs=MS)
    assert (clock.lost, clock.restarts) == (1000, 0)


def test_a_scanner_that_counts_anew_begins_a_new_fit():
    clock = MirrorClock()
    for k in range(500):
        clock.observe(k * TURN_NS, k % 256)
    times = [clock.observe((500 + k) * TURN_NS + 5 * MS, k) for k in range(200, 400)]
    assert clock.restarts == 1
    assert times[-1] == pytest.approx(899 * TURN_NS + 5 * MS, abs=MS)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 10**8), min_size=2, max_size=60), st.booleans())
def test_no_point_is_below_the_lowest_line(residuals, sloped):
    points = [(16 * k, r) for k, r in enumerate(residuals)]
    slope, offset = lowest_line(points, sloped)
    gaps = [r - offset - slope * turn for turn, r in points]
    assert min(gaps) == pytest.approx(0.0, abs=1e-3)


def test_a_shift_of_all_arrivals_shifts_all_times():
    for shift in (7 * MS, 10**12):
        a, b = MirrorClock(), MirrorClock()
        rng = np.random.default_rng(3)
        for k in range(400):
            arrival = k * TURN_NS + int(rng.uniform(0, 5 * MS))
            first, second = a.observe(arrival, k % 256), b.observe(arrival + shift, k % 256)
            assert (first is None) == (second is None)
            if first is not None and second is not None:
                assert abs(second - first - shift) <= 1000      # float rounding at 1e12


@pytest.mark.parametrize('resolution, kind', [(100, 'turns'), (50, 'turns'), (50, 'scans')])
def test_stamps_of_an_emulated_scanner_are_those_of_its_mirror(monkeypatch, resolution, kind):
    """The whole way of the bytes, in the emulator's own time, with 5 ms jitter and bursts."""
    from stri_mapping.lms_emulator.device import EmulatedLms
    from stri_mapping.lms_emulator.faults import Fault
    from stri_mapping.lms_emulator.model import Memory, OUTDOOR
    from stri_mapping.lms_emulator.room import Room
    from stri_mapping.lms_emulator.turns import Mirror, Variant

    monkeypatch.setattr(stamps, 'host_offset', lambda: 10**18)
    stream = make_stream(identify('LMS291;S05;V02.10'), kind, 180, resolution)
    period = 13.32e-3 * (1.0 + 100e-6)
    memory = Memory(rate=500000, mode=stream.request.mode, variant=Variant(180, resolution),
                    configuration=OUTDOOR.changed(indices=True))
    device = EmulatedLms(Room(), memory, mirror=Mirror(0.0, period),
                         faults=[Fault('jitter', duration=1e6, share=0.5)])
    parser, stamper = Parser(), stamps.Stamper()
    parser.byte_ns = 20_000
    stamper.restart(stream.stride(500000))
    errors = []
    while device.next_due < 15.0:
        for due, data, _ in device.arrivals(device.next_due, 500000):
            for item in parser.feed(data, round(1e9 * due)):
                assert isinstance(item, Received)
                scan = stream.measured(decode_answer(item.telegram.payload), measuring_mode(0))
                timed = stamper.date(scan, stream, item.begin_ns, False)
                if timed is not None and due > 5.0:
                    # the ray at angle 0 + raster of a turn is sent at period * (turn + a / 360)
                    ray = 1e-9 * (timed.stamp_ns - 10**18) / period - scan.first / 360.0
                    errors.append((ray - round(ray)) * period)
                    assert round(ray) % stream.turns == 0
    assert len(errors) > 9.0 / (stream.turns * period)
    assert np.sqrt(np.mean(np.square(errors))) < 0.1e-3


def test_steps_of_the_time_of_day_move_the_stamps_and_nothing_else(monkeypatch, caplog):
    offset = 10**18
    monkeypatch.setattr(stamps, 'host_offset', lambda: offset)
    stream = make_stream(identify('LMS200;301063;V02.10'), 'turns', 180, 100)
    stamper, found = stamps.Stamper(time_offset=0.25), []
    for k in range(300):
        offset = 10**18 + (-3_600 * 10**9 if k >= 200 else 0)
        answer = Scan(Samples(bytes(362), raster=0), Indices(k % 256, k % 256))
        scan = stream.measured(answer, measuring_mode(0))
        timed = stamper.date(scan, stream, k * TURN_NS, False)
        if timed is not None:
            found.append(timed.stamp_ns - offset)
    assert len(found) == 300 - SETTLED
    assert np.allclose(np.diff(found), TURN_NS, atol=1000)
    assert found[0] == pytest.approx((SETTLED - 1) * TURN_NS + 250 * MS, abs=MS)
    assert 'time of day was set by -3600.000 s' in caplog.text
