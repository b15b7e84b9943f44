# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The emulated scanner in virtual time: the document's bytes, its rates, its faults."""

from __future__ import annotations

import math

from hypothesis import given, settings, strategies
import numpy as np
import pytest

from stri_mapping.errors import UsageError
from stri_mapping.lms import requests, samples
from stri_mapping.lms.answers import decode_answer, PowerOn
from stri_mapping.lms.measuring import MODES
from stri_mapping.lms.parser import Handshake, Parser, Received
from stri_mapping.lms.telegram import frame
from stri_mapping.lms_emulator.device import EmulatedLms
from stri_mapping.lms_emulator.faults import Fault, KINDS, read_plans
from stri_mapping.lms_emulator.lateness import Lateness
from stri_mapping.lms_emulator.line import Adapter
from stri_mapping.lms_emulator.model import make_memory, Memory, Model, MODELS
from stri_mapping.lms_emulator.replies import Timing
from stri_mapping.lms_emulator.room import Room
from stri_mapping.lms_emulator.turns import Array, Mirror, Turn, Variant
from stri_mapping.lms_emulator.uart import resampled
from stri_mapping.scan import MIRROR_TURN

T = MIRROR_TURN
# Hands every byte on by itself at the instant at which it is there.
DIRECT = Adapter(packet=1, latency=0.0)


class Ramp:
    """Ranges that tell the turn and the bearing they belong to."""

    def turn(self, number: int, bearings: Array) -> Turn:
        return Turn(10.0 + 0.1 * (number % 8) + 0.001 * np.round(4.0 * (bearings + 90.0)),
                    np.full(len(bearings), 40.0))


class Host:
    """The other end of the line: sends, and collects what arrives, at whatever rate."""

    def __init__(self, device: EmulatedLms, rate: int = 9600) -> None:
        self.device, self.rate, self.now = device, rate, 0.0
        self.bytes: list[tuple[float, int]] = []

    def wait(self, seconds: float) -> bytes:
        """Let time pass; return what came meanwhile."""
        first, end = len(self.bytes), self.now + seconds
        while (due := self.device.next_due) <= end:
            for arrival in self.device.arrivals(due, self.rate):
                self.bytes += [(arrival.due, byte) for byte in arrival.data]
        self.now = end
        return bytes(byte for _, byte in self.bytes[first:])

    def send(self, data: bytes) -> None:
        self.device.receive(data, self.now, self.rate)

    def ask(self, request: requests.Request, seconds: float = 1.0) -> bytes:
        self.send(frame(request.encode()))
        return self.wait(seconds)

    def switch(self, mode: int, parameters: bytes = b'') -> None:
        assert self.ask(requests.SwitchMode(mode, parameters)).startswith(DONE)
        self.rate = self.device.memory.rate


DONE = bytes.fromhex('06 02 80 03 00 A0 00 10 16 0A')


def scanner(name: str = 'LMS291', variant: Variant | None = None, rate: int = 9600,
            **more) -> EmulatedLms:
    memory = make_memory(name, rate)
    memory.variant = variant or memory.variant
    return EmulatedLms(more.pop('source', Ramp()), memory,
                       adapter=more.pop('adapter', DIRECT), **more)


def telegrams(data: bytes) -> list[bytes]:
    return [item.telegram.payload for item in Parser().feed(data, 0)
            if isinstance(item, Received)]


def scans(data: bytes) -> list[samples.Scan]:
    return [samples.Scan.decode(payload) for payload in telegrams(data) if payload[0] == 0xB0]


# -- bytes ----------------------------------------------------------------------------------

@pytest.mark.parametrize(('sent', 'answered'), [
    ('02 00 02 00 20 24 34 08', '06 02 80 03 00 A0 00 10 16 0A'),
    ('02 00 02 00 20 25 35 08', '06 02 80 03 00 A0 00 10 16 0A'),
    ('02 00 0A 00 20 00 53 49 43 4B 5F 4C 4D 53 BE C5', '06 02 80 03 00 A0 00 10 16 0A'),
    ('02 00 02 00 20 40 50 08', '06 02 80 03 00 A0 00 10 16 0A'),
    ('02 00 05 00 3B B4 00 32 00 3B 1F', '06 02 80 07 00 BB 01 B4 00 32 00 10 03 9D'),
    ('02 00 01 00 3A 1E 12', '06 02 80 17 00 BA 4C 4D 53 32 30 30 3B 53 31 38 30 36 33 3B 56 30 '
                             '32 2E 31 39 20 10 85 6A'),
    ('02 00 01 00 10 34 12', '06 02 80 02 00 91 10 79 30'),
    ('02 00 02 00 20 99 A9 08', '06 02 80 02 00 92 10 7F 33'),
])
def test_requests_get_the_documents_answers_to_the_byte(sent, answered):
    sent = bytes.fromhex(sent)
    if sent[5] == 0x99:                                 # no such mode; its CRC is not printed
        sent = frame(sent[4:-2])
    memory = Memory(Model('LMS200;S18063;V02.19 ', MODELS['LMS200'].variants,
                          MODELS['LMS200'].configuration))
    host = Host(EmulatedLms(Ramp(), memory, adapter=DIRECT))
    host.send(sent)
    answered = bytes.fromhex(answered)
    assert host.wait(0.15)[:len(answered)] == answered


def test_the_configuration_is_read_and_written_in_installation_mode_only():
    host = Host(scanner('LMS200'))
    device = host.device
    wanted = device.memory.configuration.changed(measuring_mode=4, indices=True)
    write = requests.WriteConfiguration(wanted.block)
    assert telegrams(host.ask(write)) == [b'\x92\x10']
    assert host.ask(requests.SwitchMode(0, b'SICK_LMZ'))[1:] == frame(b'\xA0\x01\x10', 0x80)
    host.switch(requests.INSTALLATION, requests.PASSWORD)
    assert telegrams(host.ask(write)) == [b'\xF7\x01' + wanted.block + b'\x10']
    assert device.memory.writes == 1
    energy = requests.WriteConfiguration(wanted.changed(measuring_mode=0x3F).block)
    assert telegrams(host.ask(energy)) == [b'\xF7\x00' + wanted.block + b'\x10']
    assert device.memory.writes == 1
    host.switch(requests.ON_REQUEST)
    assert telegrams(host.ask(requests.ReadConfiguration())) == [b'\xF4' + wanted.block + b'\x10']


def test_the_status_tells_mode_variant_rate_and_the_time_of_a_turn():
    host = Host(scanner(variant=Variant(100, 25)))
    host.switch(requests.RATES[38400])
    status = decode_answer(telegrams(host.ask(requests.ReadStatus()))[0])
    assert (status.mode, status.angle, status.resolution) == (0x25, 100, 25)
    assert status.rate == 38400
    assert status.motor == 148


def test_a_garbled_request_gets_a_nak_and_nothing_else_and_others_are_not_answered():
    host = Host(scanner())
    request = frame(requests.ReadType().encode())
    host.send(request[:-1] + bytes((request[-1] ^ 1,)))
    assert host.wait(1.0) == b'\x15'
    host.send(frame(requests.ReadType().encode(), address=7))
    assert host.wait(1.0) == b''
    host.send(frame(requests.ReadType().encode(), address=1))
    assert host.wait(1.0)[2] == 0x81


def test_a_pause_of_more_than_6_ms_inside_a_request_loses_it():
    request = frame(requests.ReadType().encode())
    for pause, answered in ((0.005, True), (0.007, False)):
        host = Host(scanner())
        host.send(request[:4])
        host.wait(4 * 10 / 9600 + pause)
        host.send(request[4:])
        assert bool(host.wait(1.0)) == answered


def test_a_variant_that_the_model_has_not_leaves_the_old_one_and_the_s14_has_none():
    host = Host(scanner())
    refused = telegrams(host.ask(requests.SetVariant(180, 25)))
    assert refused == [bytes.fromhex('BB 00 B4 00 32 00 10')]
    assert telegrams(Host(scanner('LMS291-S14')).ask(requests.SetVariant(180, 100))) == [
        b'\x92\x10']


def test_setting_the_variant_stops_the_output():
    host = Host(scanner(rate=500000), 500000)
    host.switch(requests.EVERY_TURN)
    assert host.device.streaming
    host.ask(requests.SetVariant(180, 100))
    assert not host.device.streaming
    assert host.wait(1.0) == b''


# -- rates ----------------------------------------------------------------------------------

HALF, ONE = Variant(180, 50), Variant(180, 100)
# TL table 10-17: telegrams, their bytes, and scans a second at 9600, 19200, 38400, 500000 Bd.
TABLE = [
    ('LMS291', ONE, 0x24, b'', 372, (2.50, 5.01, 9.38, 75.1)),
    ('LMS291', Variant(100, 100), 0x24, b'', 212, (4.42, 8.34, 15.0, 75.1)),
    ('LMS291', HALF, 0x24, b'', 732, (1.29, 2.50, 4.69, 37.5)),
    ('LMS291', Variant(100, 50), 0x24, b'', 412, (2.21, 4.17, 7.51, 37.5)),
    ('LMS291', Variant(100, 25), 0x24, b'', 812, (1.17, 2.35, 4.69, 18.8)),
    ('LMS291', ONE, 0x2A, b'', 372, (2.50, 5.01, 9.38, 75.1)),
    ('LMS291-S14', None, 0x50, requests.words(1, 181), 559, (1.71, 3.41, 6.83, 75.1)),
]


@pytest.mark.parametrize(('name', 'variant', 'mode', 'parameters', 'size', 'rates'), TABLE)
def test_streams_have_the_sizes_and_the_rates_of_the_listing(
        name, variant, mode, parameters, size, rates):
    for baud, expected in zip((9600, 19200, 38400, 500000), rates):
        device = scanner(name, variant, baud, adapter=Adapter())
        host = Host(device, baud)
        host.switch(mode, parameters)
        while len(host.bytes) < len(DONE) + 5 * size + 1:
            host.wait(0.1)
        begins = np.array([t for t, _ in host.bytes[len(DONE):len(DONE) + 5 * size + 1:size]])
        assert all(host.bytes[len(DONE) + k * size][1] == 2 for k in range(6))
        scan = device.memory.variant.turns * T if mode != requests.EVERY_TURN else T
        period = math.ceil(size * 10 / baud / scan) * scan
        np.testing.assert_allclose(np.diff(begins), period, atol=1e-9)
        assert 1.0 / period == pytest.approx(expected, rel=0.006)       # the table's rounding


def test_a_scan_of_one_turn_leaves_when_the_turn_is_over_and_takes_its_time_on_the_line():
    device = scanner(variant=ONE, rate=500000, mirror=Mirror(0.004, T))
    host = Host(device, 500000)
    host.switch(requests.EVERY_TURN)
    host.wait(0.5)
    times = np.array([t for t, _ in host.bytes[len(DONE):]])
    assert np.diff(times).min() >= 10 / 500000 - 1e-9
    first = times[:372 * 20:372]
    # the first byte is there ten bit times after the turn's end
    turns = (first - 10 / 500000 - 0.004) / T
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-6)
    np.testing.assert_allclose(np.diff(turns), 1.0, atol=1e-6)
    assert times[371] - times[0] == pytest.approx(371 * 10 / 500000)


def test_at_most_508_bytes_leave_in_a_turn_at_500_kbd():
    device = scanner(variant=HALF, rate=500000)
    host = Host(device, 500000)
    host.switch(requests.ALL_VALUES)
    host.wait(0.5)
    times = np.array([t for t, _ in host.bytes[len(DONE):len(DONE) + 732]])
    gaps = np.diff(times)
    assert np.flatnonzero(gaps > 1e-3).tolist() == [507]
    assert times[508] - times[0] == pytest.approx(T)
    assert gaps.max() < 0.014                           # TL 4.3


def test_real_time_indices_cost_the_fast_model_no_scan():
    device = scanner('LMS291-S14', rate=500000, adapter=Adapter())
    device.memory.configuration = device.memory.configuration.changed(indices=True)
    host = Host(device, 500000)
    host.switch(requests.REMISSION, requests.words(1, 181))
    host.wait(1.0)
    assert device.counts.dropped == 0


def test_a_mirror_100_ppm_slow_is_1_ms_behind_after_10_s():
    for ppm, behind in ((0.0, 0.0), (100.0, 1e-3)):
        device = scanner(variant=ONE, rate=500000, mirror=Mirror(0.0, T * (1 + 1e-6 * ppm)),
                         adapter=Adapter(packet=372))
        host = Host(device, 500000)
        host.switch(requests.EVERY_TURN)
        host.wait(11.0)
        starts = [t for t, _ in host.bytes[len(DONE)::372]]
        assert starts[751] - starts[0] - 751 * T == pytest.approx(behind, abs=1e-5)


# -- scans ----------------------------------------------------------------------------------

def test_one_telegram_a_turn_alternates_rasters_and_counts_turns_and_telegrams():
    device = scanner(variant=HALF, rate=500000)
    device.memory.configuration = device.memory.configuration.changed(
        indices=True, unit=1, measuring_mode=6)
    host = Host(device, 500000)
    host.switch(requests.EVERY_TURN)
    found = scans(host.wait(1.0))
    assert [s.samples.raster for s in found[:4]] in ([0, 2, 0, 2], [2, 0, 2, 0])
    turns = np.array([s.indices.turn for s in found])
    assert set(np.diff(turns) % 256) == {1}
    assert set(np.diff([s.indices.telegram for s in found]) % 256) == {1}
    for scan in found:
        n = 181 if scan.samples.raster == 0 else 180
        bearings = -90.0 + 0.25 * scan.samples.raster + np.arange(n)
        ranges = MODES[6].ranges(scan.samples.words, 1)
        exact = Ramp().turn(scan.indices.turn, bearings).ranges     # 256 is a multiple of 8
        np.testing.assert_allclose(ranges, exact, atol=0.0005 + 1e-9)   # steps of 1 mm


@pytest.mark.parametrize('variant', [ONE, HALF, Variant(100, 25)])
def test_whole_scans_interlace_their_turns(variant):
    device = scanner(variant=variant, rate=500000)
    device.memory.configuration = device.memory.configuration.changed(
        indices=True, unit=1, measuring_mode=6)
    host = Host(device, 500000)
    host.switch(requests.ALL_VALUES)
    for scan in scans(host.wait(1.0)):
        assert (scan.indices.turn + 1) % variant.turns == 0
        n = variant.angle * 100 // variant.resolution + 1
        bearing = -variant.angle / 2 + 0.01 * variant.resolution * np.arange(n)
        turn = scan.indices.turn - variant.turns + 1 + np.arange(n) % variant.turns
        exact = 10.0 + 0.1 * (turn % 8) + 0.001 * np.round(4.0 * (bearing + 90.0))
        np.testing.assert_allclose(MODES[6].ranges(scan.samples.words, 1), exact, atol=0.00051)


def test_parts_pairs_and_single_scans_are_cut_from_whole_ones():
    device = scanner(variant=ONE, rate=500000)
    host = Host(device, 500000)
    single = scans(host.ask(requests.ReadScan(), 0.2))
    assert [len(s.samples) for s in single] == [181]
    part = samples.SubRange.decode(telegrams(host.ask(requests.ReadSubRange(27, 99), 0.2))[0])
    assert (part.first, part.last, len(part.samples)) == (27, 99, 73)
    host.switch(requests.PAIRS, requests.words(2, 1, 10, 91, 100))
    pairs = samples.PairScan.decode(telegrams(host.wait(0.5))[0])
    assert [(p.first, p.last, len(p.distances)) for p in pairs.ranges] == [(1, 10, 10),
                                                                          (91, 100, 10)]
    assert set(pairs.ranges[0].remissions) == {5200}    # 40 % of 13000
    assert b'\x92\x10' in telegrams(host.ask(requests.ReadSubRange(99, 27), 0.2))


def test_the_fast_model_sends_distance_and_remission_in_one_turn():
    host = Host(scanner('LMS291-S14', rate=500000), 500000)
    host.switch(requests.REMISSION, requests.words(1, 181))
    data = host.wait(0.5)
    scan = samples.RemissionScan.decode(telegrams(data)[0])
    assert len(scan.samples) == len(scan.remission) == 181
    assert set(scan.remission) == {102}                 # 40 % of 255
    assert telegrams(Host(scanner()).ask(requests.SwitchMode(
        requests.REMISSION, requests.words(1, 181)))) == [b'\x92\x10']


@given(strategies.sampled_from(sorted(MODES)), strategies.integers(0, 1),
       strategies.lists(strategies.floats(0.0, 400.0) | strategies.sampled_from(
           [math.inf, math.nan]), min_size=1, max_size=20))
def test_what_the_words_say_is_the_range_to_half_a_step(mode, unit, ranges):
    from stri_mapping.lms.measuring import UNITS
    from stri_mapping.lms_emulator.turns import words
    configuration = MODELS['LMS291'].configuration.changed(measuring_mode=mode, unit=unit)
    exact = np.array(ranges)
    read = MODES[mode].ranges(words(exact, configuration), unit)
    near = exact < MODES[mode].range_max(unit) - UNITS[unit]
    np.testing.assert_allclose(read[near], exact[near], atol=0.5 * UNITS[unit] + 1e-9)
    beyond = exact > MODES[mode].range_max(unit)
    assert np.all(np.isposinf(read[beyond]))
    assert np.all(np.isnan(read[np.isnan(exact)]))


def test_a_turn_that_the_source_cannot_tell_is_left_out():
    class Gappy(Ramp):
        def turn(self, number, bearings):
            return None if number % 10 == 3 else super().turn(number, bearings)

    device = scanner(variant=ONE, rate=500000, source=Gappy())
    device.memory.configuration = device.memory.configuration.changed(indices=True)
    host = Host(device, 500000)
    host.switch(requests.EVERY_TURN)
    before = device.counts.starved
    turns = np.diff([s.indices.turn for s in scans(host.wait(1.0))]) % 256
    assert set(turns) == {1, 2}
    # but for those at both ends of the second
    assert abs(device.counts.starved - before - np.count_nonzero(turns == 2)) <= 1


# -- rate changes, interruption -------------------------------------------------------------

def test_the_answer_to_a_rate_change_comes_at_the_old_rate_and_then_the_new_one_holds():
    host = Host(scanner())
    assert host.ask(requests.SwitchMode(requests.RATES[500000])) == DONE
    assert host.ask(requests.ReadType()) == b''         # the host still listens at 9600
    host.rate = 500000
    assert telegrams(host.ask(requests.ReadType()))[0][0] == 0xBA


def test_a_host_at_another_rate_hears_garbage_and_is_not_heard():
    device = scanner(variant=ONE, rate=38400)
    host = Host(device, 38400)
    host.switch(requests.EVERY_TURN)
    host.rate = 9600
    garbage = host.wait(2.0)
    assert 0 < len(garbage) <= 2.0 * 960 and telegrams(garbage) == []
    host.ask(requests.SwitchMode(requests.ON_REQUEST))
    assert device.streaming


@given(strategies.binary(max_size=60), strategies.sampled_from([9600, 38400, 500000]),
       strategies.sampled_from([9600, 38400, 500000]))
def test_a_receiver_at_another_rate_never_reads_more_bytes_than_the_line_had_edges(
        data, sent, received):
    read = resampled(data, sent, received)
    if sent == received:
        assert read == data
    else:
        # a start needs a falling edge, of which a byte has at most five
        assert len(read) <= 5 * len(data)
        assert bool(read) == bool(data)


def test_bits_at_half_the_rate_read_double():
    # 0x00 holds the line low for 9 bits, 18 of the receiver's: a start and eight zeros
    assert resampled(b'\x00', 9600, 19200) == b'\x00'
    # 0x55 toggles: 0 1010 1010 1, each bit twice
    assert resampled(b'\x55', 9600, 19200)[0] == 0b01100110


def test_a_request_cuts_the_telegram_on_the_line_and_the_next_scan_comes_whole():
    device = scanner(variant=ONE, rate=38400)
    device.memory.configuration = device.memory.configuration.changed(indices=True)
    host = Host(device, 38400)
    host.switch(requests.EVERY_TURN)
    host.wait(0.3)
    assert device.counts.interrupted == 0
    first = len(host.bytes)
    data = host.ask(requests.ReadType())
    assert device.counts.interrupted == 1
    assert device.streaming
    items = Parser().feed(bytes(b for _, b in host.bytes[len(DONE):]), 0)
    kinds = [i.telegram.payload[0] for i in items if isinstance(i, Received)]
    assert kinds.count(0xBA) == 1
    assert len(kinds) > 8 and set(kinds) == {0xB0, 0xBA}
    # what is left of the cut scan, then at once the ACK, the answer, and a header
    at = data.index(b'\x06\x02\x80\x17\x00\xBA')
    assert 0 <= at < 374
    assert data[at + 30:at + 34] == bytes.fromhex('02 80 70 01')
    assert first > 0


def test_a_request_in_the_pause_of_a_split_telegram_cuts_it_too():
    device = scanner(variant=HALF, rate=500000, timing=Timing(answer=0.001, ack=0.0005))
    host = Host(device, 500000)
    host.switch(requests.ALL_VALUES)
    start = 2.0 * T * math.ceil(host.now / (2.0 * T))           # of the next telegram
    host.wait(start - host.now + 508 * 10 / 500000 + 0.001)     # between its two parts
    host.send(frame(requests.ReadType().encode()))
    data = host.wait(0.02)
    assert data.startswith(b'\x06\x02\x80\x17\x00\xBA')
    assert device.counts.interrupted == 1


# -- start, reset, faults -------------------------------------------------------------------

def test_a_reset_brings_the_power_on_message_and_the_defaults_back():
    device = scanner(rate=500000, variant=ONE, timing=Timing(start=2.0))
    host = Host(device, 500000)
    host.switch(requests.EVERY_TURN)
    data = host.ask(requests.Reset(), 0.5)
    assert b'\x06' + frame(b'\x91\x10', 0x80) in data
    host.rate = 9600
    assert host.ask(requests.ReadType(), 1.0) == b''    # it is still starting
    message = telegrams(host.wait(2.0))
    assert message == [PowerOn('LMS291;S05063;V02.10 ').encode()]
    assert not device.streaming
    assert (device.memory.rate, device.memory.variant) == (9600, HALF)


def test_a_rate_that_is_kept_survives_a_power_cycle():
    device = scanner(timing=Timing(start=1.0))
    host = Host(device)
    host.switch(requests.RATES[38400])
    assert telegrams(host.ask(requests.SetPowerOn(1))) == [b'\xE6\x01\x01\x10']
    device.inject(Fault('power_cycle', duration=0.5), host.now)
    assert telegrams(host.wait(3.0)) == [PowerOn('LMS291;S05063;V02.10 ').encode()]
    assert device.memory.rate == 38400


def streaming(*faults: Fault, **kept) -> Host:
    device = scanner(variant=ONE, rate=500000, faults=faults, seed=3, timing=Timing(start=1.0),
                     **kept)
    device.memory.configuration = device.memory.configuration.changed(indices=True)
    host = Host(device, 500000)
    host.switch(requests.EVERY_TURN)
    return host


@pytest.mark.parametrize('kind', ['crc', 'drop', 'insert', 'cut'])
def test_spoilt_telegrams_are_spoilt_only_while_the_fault_is_on(kind):
    host = streaming(Fault(kind, at=1.0, duration=2.0, share=0.5, since='stream'))
    turns = [s.indices.turn for s in scans(host.wait(4.0))]
    lost = sum((np.diff(turns) - 1) % 256)
    # 150 telegrams hit with chance one half: 75 +- 6 (one sigma), and neighbours of cut ones
    assert 50 < lost < 110
    assert len(turns) + lost == pytest.approx(300, abs=3)


def test_silence_is_silent_and_deaf_and_leaves_the_stream_as_it_was():
    host = streaming(Fault('silence', at=2.0, duration=1.0))
    host.wait(1.0)
    quiet = [t for t, _ in host.bytes]
    host.ask(requests.SwitchMode(requests.ON_REQUEST), 1.0)
    times = np.array([t for t, _ in host.bytes])
    assert not np.any((times > 2.0) & (times < 3.0))
    assert len(quiet) > 1000 and host.device.streaming
    assert len(scans(host.wait(0.5))) > 30


def test_naks_and_misses_hit_requests_only():
    host = Host(scanner(faults=[Fault('nak', duration=1.0), Fault('miss', at=1.0)]))
    assert host.ask(requests.ReadType(), 1.0) == b'\x15'
    assert host.ask(requests.ReadType(), 1.0) == b''
    assert len(host.ask(requests.ReadType(), 1.0)) == 30


def test_a_scanner_can_be_found_at_another_rate_and_streaming():
    device = scanner(variant=ONE, faults=[Fault('wrong_rate', rate=500000), Fault('streaming')])
    host = Host(device, 500000)
    assert len(scans(host.wait(1.0))) == pytest.approx(74, abs=1)
    assert telegrams(host.ask(requests.SwitchMode(requests.ON_REQUEST)))[-1] == b'\xA0\x00\x10'
    host.switch(requests.RATES[9600])
    assert host.wait(1.0) == b''


def test_a_power_cycle_takes_the_device_away_and_it_comes_back_stopped():
    host = streaming(Fault('power_cycle', at=1.5, duration=1.0))
    host.wait(0.6)
    assert not host.device.present(host.now)
    assert host.wait(0.8) == b''
    assert host.device.present(2.6)
    host.rate = 9600
    assert telegrams(host.wait(2.0)) == [PowerOn('LMS291;S05063;V02.10 ').encode()]
    assert not host.device.streaming


def test_an_unplugged_scanner_runs_on():
    host = streaming(Fault('unplug', at=1.5, duration=1.0))
    host.wait(0.6)
    assert not host.device.present(host.now)
    assert host.wait(0.8) == b''
    assert len(scans(host.wait(1.0))) > 30


def test_jitter_delays_within_its_bounds_and_keeps_the_order():
    fault = Fault('jitter', at=0.0, duration=1e6, share=0.5, jitter=0.005, burst=0.016)
    calm, shaken = streaming(adapter=Adapter(10)), streaming(fault, adapter=Adapter(10))
    calm.wait(5.0)
    shaken.wait(5.0)
    assert [b for _, b in calm.bytes[:100000]] == [b for _, b in shaken.bytes[:100000]]
    n = 130000
    delay = np.array([s[0] - c[0] for s, c in zip(shaken.bytes[:n], calm.bytes[:n])])
    assert np.all(np.diff([t for t, _ in shaken.bytes]) >= 0.0)
    assert delay.min() >= -1e-12
    assert delay.max() <= 0.016 + 0.005
    assert np.any(delay > 0.010) and np.mean(delay < 0.0051) > 0.2


def test_a_second_request_while_one_is_in_work_is_not_noticed():
    host = Host(scanner())
    host.send(frame(requests.ReadType().encode()))
    host.wait(0.02)
    host.send(frame(requests.ReadConfiguration().encode()))
    assert [p[0] for p in telegrams(host.wait(2.0))] == [0xBA]


@given(strategies.lists(strategies.binary(max_size=40), max_size=30),
       strategies.integers(0, 2**32))
@settings(max_examples=30, deadline=None)
def test_whatever_a_host_sends_the_scanner_goes_on(chunks, seed):
    host = Host(scanner(variant=ONE, rate=38400, seed=seed), 38400)
    for k, chunk in enumerate(chunks):
        host.send(chunk if k % 3 else frame(chunk[:30] or b'1'))
        host.wait(0.01 * (k % 4))
    host.wait(20.0)                                     # a reset may have been among them
    for host.rate in (9600, 19200, 38400, 500000):
        handshakes = [i for i in Parser().feed(host.ask(requests.ReadType(), 1.0), 0)
                      if isinstance(i, Handshake)]
        if handshakes:
            return
    pytest.fail('no answer at any rate')


# -- plans, models, room --------------------------------------------------------------------

def test_plans_are_read_from_yaml_and_json(tmp_path):
    path = tmp_path / 'plan'
    path.write_text('front:\n  - {kind: crc, at: 5.0, share: 0.5}\n  - {kind: reset, since: '
                    'stream}\nrear: []\n')
    assert read_plans(path) == {'front': [Fault('crc', 5.0, share=0.5),
                                          Fault('reset', since='stream')], 'rear': []}
    path.write_text('{"front": [{"kind": "unplug", "duration": 2}]}')
    assert read_plans(path) == {'front': [Fault('unplug', duration=2)]}


@pytest.mark.parametrize(('text', 'words'), [
    ('[]', 'mapping of scanner names'), ('front: 3', 'front: want a list'),
    ('front: [{at: 1}]', 'front[0]: want a mapping with kind'),
    ('front: [{kind: fire}]', 'front[0]: fault kind is'),
    ('front: [{kind: crc, share: 2}]', 'front[0]: fault share is 2: want 0 to 1'),
    ('front: [{kind: wrong_rate, rate: 4800}]', 'front[0]: fault rate is 4800; want 9600'),
    ('front: [{kind: crc, often: 2}]', "unknown key 'often'"), ('a: [b', 'not YAML'),
])
def test_a_faulty_plan_is_refused_naming_the_place(tmp_path, text, words):
    path = tmp_path / 'plan.yaml'
    path.write_text(text)
    with pytest.raises(UsageError, match=str(path)) as caught:
        read_plans(path)
    assert words in str(caught.value)


def test_unknown_models_and_rates_are_refused():
    with pytest.raises(UsageError, match='known are LMS200'):
        make_memory('LMS500')
    with pytest.raises(UsageError, match='line rate is 4800'):
        make_memory('LMS200', 4800)
    assert all(len(model.text) == 21 for model in MODELS.values())
    assert len(KINDS) == len(set(KINDS))


def test_the_room_is_the_same_turn_for_turn_and_has_its_walls():
    bearings = Variant(180, 100).bearings(0)
    room = Room(5)
    turn = room.turn(7, bearings)
    np.testing.assert_array_equal(turn.ranges, Room(5).turn(7, bearings).ranges)
    assert turn.ranges[0] == pytest.approx(3.0, abs=0.05)       # 5 sigma of its noise
    assert turn.ranges[180] == pytest.approx(4.0, abs=0.05)


def test_lateness_is_counted_to_a_tenth():
    lateness = Lateness()
    for k in range(1000):
        lateness.add(1e-5 * k)
    assert lateness.figures.p50 == pytest.approx(0.005, rel=0.11)
    assert lateness.figures.p99 == pytest.approx(0.0099, rel=0.11)
    assert lateness.figures.worst == pytest.approx(0.00999)
    assert Lateness().figures.p99 == 0.0
