# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Sample words to ranges and flags, models and variants, what lines carry, where rays are."""

from __future__ import annotations

from dataclasses import asdict

from hypothesis import given, settings
from hypothesis import strategies as st
from lms_rig import Numbered, ranges_of
import numpy as np
import pytest

from stri_mapping.errors import LmsError, UsageError
from stri_mapping.lms import samples
from stri_mapping.lms.answers import decode_answer
from stri_mapping.lms.configuration import Configuration, FACTORY
from stri_mapping.lms.measuring import measuring_mode, MODES
from stri_mapping.lms.models import FAST_MODELS, identify, MODELS
from stri_mapping.lms.settings import LmsSettings
from stri_mapping.lms.stream import make_stream, rate_table
from stri_mapping.lms.telegram import frame
from stri_mapping.lms_emulator.model import make_memory
from stri_mapping.lms_emulator.streams import make_stream as emulated_stream
from stri_mapping.lms_emulator.turns import Variant as EmulatedVariant

LMS291, S14 = identify('LMS291;S05063;V02.10 '), identify('LMS291;S14063;V02.10 ')
MM, CM = samples.MILLIMETRES, samples.CENTIMETRES


def packed(*values: int) -> samples.Samples:
    return samples.Samples(np.array(values, '<u2').tobytes())


@pytest.mark.parametrize('number, bits, metres_mm, metres_cm', [
    (0, 13, 8.183, 81.83), (1, 13, 8.183, 81.83), (2, 13, 8.183, 81.83), (3, 14, 16.375, 163.75),
    (4, 14, 16.375, 163.75), (5, 15, 32.759, 327.59), (6, 15, 32.759, 327.59),
    (0x0F, 15, 32.759, 327.59)])
def test_distances_and_codes_by_the_number_of_bits(number, bits, metres_mm, metres_cm):
    mode, top = measuring_mode(number), 1 << bits
    assert mode.range_max(MM) == pytest.approx(metres_mm)
    assert mode.range_max(CM) == pytest.approx(metres_cm)
    values = np.array([0, 1, 1234, top - 10, top - 9, *range(top - 8, top)], np.uint16)
    ranges = mode.ranges(values, MM)
    assert np.allclose(ranges[:4], [0.0, 0.001, 1.234, 0.001 * (top - 10)])
    assert ranges[4] == np.inf                  # beyond maximum: nothing in range
    assert np.all(np.isnan(ranges[5:]))         # dazzled, too weak, ...: no reading at all
    assert mode.ranges(values, CM)[2] == pytest.approx(12.34)


@settings(deadline=None)
@given(st.sampled_from(sorted(set(MODES) - {0x0F})), st.lists(st.integers(0, 0xFFFF), max_size=50))
def test_flags_do_not_touch_distances(number, values):
    mode, words = measuring_mode(number), np.array(values, np.uint16)
    mask = np.uint16((1 << mode.bits) - 1)
    assert np.array_equal(mode.ranges(words, MM), mode.ranges(words & mask, MM), equal_nan=True)
    rebuilt = (words & mask).astype(int)
    for name, low, _ in mode.flags:
        rebuilt |= mode.flag(name, words).astype(int) << low
    flagged = sum(width for _, _, width in mode.flags)
    assert not mode.flags or (mode.bits + flagged == 16 and np.array_equal(rebuilt, words))


def test_modes_without_distance_and_reserved_units_are_refused():
    with pytest.raises(LmsError, match='gives energy, not distance; known are 0, 1'):
        measuring_mode(0x3F)
    with pytest.raises(LmsError, match='0x77 is unknown'):
        measuring_mode(0x77)
    with pytest.raises(LmsError, match='unit 2 .* reserved'):
        measuring_mode(0).ranges(np.zeros(1, np.uint16), 2)
    with pytest.raises(LmsError, match='no flag "field_c"'):
        measuring_mode(0).flag('field_c', np.zeros(1, np.uint16))


# The telegram listing's table of bytes and rates (9600, 19200, 38400, 500000 Bd).
@pytest.mark.parametrize('kind, angle, resolution, size, rates', [
    ('turns', 180, 100, 372, (2.50, 5.01, 9.38, 75.1)),
    ('scans', 180, 100, 372, (2.50, 5.01, 9.38, 75.1)),
    ('scans', 100, 100, 212, (4.42, 8.34, 15.0, 75.1)),
    ('scans', 180, 50, 732, (1.29, 2.50, 4.69, 37.5)),
    ('scans', 100, 50, 412, (2.21, 4.17, 7.51, 37.5)),
    ('scans', 100, 25, 812, (1.17, 2.35, 4.69, 18.8))])
def test_what_each_line_rate_carries(kind, angle, resolution, size, rates):
    stream = make_stream(LMS291, kind, angle, resolution)
    assert stream.telegram_bytes(indices=False) == size
    for rate, hertz in zip((9600, 19200, 38400, 500000), rates):
        assert float(f'{stream.frequency(rate, indices=False):.3g}') == hertz
        assert f'{rate} Bd gives {hertz:.3g} Hz' in rate_table(stream, indices=False)


def test_an_s14_has_its_own_variant_and_remission():
    stream = make_stream(S14, 'remission', 180, 100)
    assert (stream.variant.count, stream.variant.first, stream.turns) == (181, 45.0, 1)
    assert stream.telegram_bytes(indices=False) == 559
    assert stream.frequency(38400, indices=False) == pytest.approx(6.83, abs=0.005)
    assert stream.request.encode() == bytes.fromhex('20 50 01 00 B5 00')


@pytest.mark.parametrize('type_text, kind, angle, resolution, said', [
    ('LMS200;301063;V02.10', 'scans', 180, 25, 'an LMS200 has no 180 deg at 0.25 deg; it has '
     '180 deg at 1 deg, 180 deg at 0.5 deg, 100 deg at 1 deg'),
    ('LMS291;S14063;V02.10', 'turns', 180, 25, 'it has 90 deg at 0.5 deg'),
    ('LMS211;302063;V02.10', 'scans', 180, 50, 'it has 100 deg at 1 deg, 100 deg at 0.5 deg'),
    ('PLS101;200000;V01.00', 'turns', 180, 100, 'calls itself "PLS101;200000;V01.00": want one'),
    ('LMS200;301063;V02.10', 'movies', 180, 100, 'known are turns, scans, remission')])
def test_what_a_model_does_not_have_is_said_with_what_it_has(
        type_text, kind, angle, resolution, said):
    with pytest.raises(LmsError, match=said):
        make_stream(identify(type_text), kind, angle, resolution)


def test_every_model_has_a_stream_of_turns_at_each_of_its_resolutions():
    texts = [f'{name};301063;V02' for name in MODELS] + [f'{name};S14;V' for name in FAST_MODELS]
    for model in map(identify, texts):
        for variant in model.variants:
            assert make_stream(model, 'turns', 180, variant.resolution).turns == 1


@pytest.mark.parametrize('resolution, rasters', [(100, [0]), (50, [0, 2]), (25, [0, 1, 2, 3])])
def test_rays_of_single_turns(resolution, rasters):
    stream, mode = make_stream(LMS291, 'turns', 180, resolution), measuring_mode(0)
    for raster in range(4):
        count = 181 if raster == 0 else 180
        scan = stream.measured(
            samples.Scan(samples.Samples(bytes(2 * count), raster=raster)), mode)
        assert (scan is not None) == (raster in rasters)
        if scan is not None:
            assert (scan.first, scan.step, scan.turns_back) == (0.25 * raster, 1.0, 1)
    whole = samples.Scan(samples.Samples(bytes(2 * 361)))
    assert stream.measured(whole, mode) is None         # of another stream, left over


@settings(deadline=None)
@given(st.sampled_from([(180, 100), (180, 50), (100, 50), (100, 25)]), st.data())
def test_rays_of_a_part_of_single_turns(variant, data):
    """The emulated scanner sends each turn's rays, and the driver puts each where it was."""
    angle, resolution = variant
    step = 0.01 * resolution
    first = data.draw(st.integers(0, round((angle - 2) / step))) * step + 90 - 0.5 * angle
    last = data.draw(st.integers(round((first + 1.0) / step),
                                 round((90 + 0.5 * angle) / step))) * step
    stream = make_stream(LMS291, 'turns', angle, resolution, first, last)
    memory = make_memory('LMS291')
    memory.variant = EmulatedVariant(angle, resolution)
    sent = emulated_stream(stream.request, memory, Numbered())
    assert sent is not None and stream.turns == sent.turns == 1
    bearings = []
    for turn in range(stream.variant.turns):
        payload = sent.payload(turn, 0)
        assert payload is not None
        assert len(frame(payload)) <= stream.telegram_bytes(memory.configuration.indices)
        scan = stream.measured(decode_answer(payload), measuring_mode(0))
        assert scan is not None
        bearings.append(scan.first - 90.0 + scan.step * np.arange(len(scan.ranges)))
        assert np.allclose(scan.ranges, ranges_of(turn, bearings[-1]), atol=1e-9)
    assert np.allclose(np.sort(np.concatenate(bearings)),
                       np.arange(first, last + 1e-9, step) - 90.0)


@pytest.mark.parametrize('first, last, bounds, first_turn', [
    (27.0, 100.0, (55, 201), 2), (27.5, 90.0, (56, 181), 1)])
def test_rays_of_a_part_of_whole_scans(first, last, bounds, first_turn):
    stream = make_stream(LMS291, 'scans', 180, 50, first, last)
    assert stream.bounds == bounds
    count = bounds[1] - bounds[0] + 1
    answer = samples.SubRange(*bounds, samples.Samples(bytes(2 * count)))
    scan = stream.measured(answer, measuring_mode(0))
    assert scan is not None
    assert (scan.first, scan.step, len(scan.ranges)) == (first, 0.5, count)
    assert scan.turns_back == first_turn        # which of the two turns its first ray belongs to
    other = samples.SubRange(bounds[0] + 1, bounds[1], answer.samples)
    assert stream.measured(other, measuring_mode(0)) is None


def test_limits_beyond_the_scan_have_no_effect_and_limits_without_a_ray_are_refused():
    assert make_stream(LMS291, 'scans', 100, 50, 0.0, 180.0).first is None
    with pytest.raises(LmsError, match='0 to 30 deg is no part of the 40 to 140 deg'):
        make_stream(LMS291, 'scans', 100, 50, 0.0, 30.0)
    with pytest.raises(LmsError, match='50 to 50.5 deg is too narrow for single turns'):
        make_stream(LMS291, 'turns', 100, 25, 50.0, 50.5)


def test_remission_goes_with_its_range():
    stream = make_stream(S14, 'remission', 90, 50)
    remission = bytes(range(181))
    answer = samples.RemissionScan(samples.Samples(bytes(362)), 1, 181, remission)
    scan = stream.measured(answer, measuring_mode(0))
    assert scan is not None and scan.intensities is not None
    assert np.array_equal(scan.intensities, np.arange(181))
    stream = make_stream(LMS291, 'remission', 180, 100, 10.0, 12.0)
    pairs = samples.PairRange(11, 13, packed(100, 7, 200, 8, 300, 9))
    scan = stream.measured(samples.PairScan((pairs,)), measuring_mode(0x0D))
    assert scan is not None and scan.intensities is not None
    assert np.allclose(scan.ranges, [0.1, 0.2, 0.3])
    assert np.array_equal(scan.intensities, [7, 8, 9])
    assert scan.first == 10.0


def test_reflector_levels_are_intensities_and_fields_are_not():
    stream = make_stream(LMS291, 'turns', 180, 100)
    words = samples.Samples(np.full(181, 0xA123, '<u2').tobytes(), raster=0)
    with_levels = stream.measured(samples.Scan(words), measuring_mode(1))
    without = stream.measured(samples.Scan(words), measuring_mode(0))
    assert with_levels is not None and without is not None
    assert with_levels.intensities is not None and np.all(with_levels.intensities == 5)
    assert without.intensities is None
    assert np.array_equal(with_levels.ranges, without.ranges)


def test_settings_change_what_they_must_of_a_configuration_and_nothing_else():
    present = Configuration(bytes(range(1, 35)))
    assert LmsSettings(real_time_index=False).configuration(present) == present
    changed = LmsSettings(unit='mm', measuring_mode=4, sensitivity=3).configuration(present)
    differing = {k for k in range(34) if present.block[k] != changed.block[k]}
    assert differing == {3, 4, 5, 6}
    assert changed.block[4] == 5 | 2            # the other bits of the byte stay
    assert (changed.measuring_mode, changed.unit, changed.indices) == (4, 1, True)
    assert len(FACTORY.block) == 34
    with pytest.raises(LmsError, match='33 bytes: want 32 or 34'):
        Configuration(bytes(33))


@pytest.mark.parametrize('values, said', [
    ({'serial_baud': 57600}, 'serial_baud is 57600: want one of 9600, 19200, 38400, 500000'),
    ({'resolution': 0.75}, 'resolution is 0.75: want one of 1.0, 0.5, 0.25'),
    ({'scan_angle': 90}, 'scan_angle is 90: want one of 180, 100'),
    ({'unit': 'inch'}, 'unit is inch: want one of keep, cm, mm'),
    ({'stream': 'turn'}, 'stream is turn: want one of turns'),
    ({'latency': 5.0}, 'latency is 5.0: want -1 to 1'),
    ({'measuring_mode': 9}, '0x09 is unknown; known are')])
def test_settings_that_no_scanner_has_are_refused(values, said):
    with pytest.raises((UsageError, LmsError), match=said):
        LmsSettings(**values)
    assert asdict(LmsSettings())['stream'] == 'turns'
