# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The driver on emulated scanners behind ptys: found, set up, got back, and left well."""

from __future__ import annotations

from collections import deque
import threading
import time

from lms_rig import inject, rigs, wait
import numpy as np
import pytest

from stri_mapping.errors import LmsError
from stri_mapping.lms import answers, requests, samples
from stri_mapping.lms.configuration import FACTORY
from stri_mapping.lms.device import CancelledError, Device, NoAnswerError
from stri_mapping.lms.driver import Driver
from stri_mapping.lms.line import Line
from stri_mapping.lms.parser import Parser
from stri_mapping.lms.requests import EVERY_TURN, ON_REQUEST
from stri_mapping.lms.settings import LmsSettings
from stri_mapping.lms.status import Status
from stri_mapping.lms.telegram import ACK, frame, NAK
from stri_mapping.lms_emulator.faults import Fault


def check_published(rig) -> None:
    """Check that no range was wrong, nothing came twice, and stamps rise."""
    turns = rig.turns()
    assert len(set(turns)) == len(turns)
    assert np.all(np.diff([timed.stamp_ns for _, timed in rig.got]) > 0)
    # the true order; how true the times are is told where the machine's load does not matter
    assert np.all(np.diff(np.unwrap(turns, period=4000)) > 0)
    errors = rig.stamp_errors()
    assert np.median(np.abs(errors)) < 5e-3


# Seconds from scans that come well to a fault, so that the clock has settled.
WELL = 0.7


DAMAGE = ('crc', 'drop', 'insert', 'cut')


@pytest.mark.parametrize('kinds', [
    DAMAGE, ('silence', 'unplug', 'reset', 'power_cycle')])
def test_after_each_fault_it_streams_again_with_nothing_wrong_twice_or_out_of_order(
        tmp_path, kinds):
    with rigs(tmp_path, dict.fromkeys(kinds, ())) as (ports, made):
        wait(lambda: all(len(rig.got) > WELL * 75 for rig in made.values()), 'scans')
        over = {kind: inject(ports, rig, Fault(kind, duration=1.0, share=0.5))
                for kind, rig in made.items()}
        for kind, rig in made.items():
            wait(lambda rig=rig, kind=kind: sum(at > over[kind] for at, _ in rig.got) > 40,
                 f'scans after {kind}')
    for kind, rig in made.items():
        check_published(rig)
        assert (rig.device.memory.mode, rig.device.memory.rate) == (ON_REQUEST, 9600)
        if kind in DAMAGE:
            assert rig.driver.stamper.lost > 0
            assert rig.driver.counts.crc_errors > 0
            assert rig.driver.reconnects == 0
        else:
            assert rig.driver.reconnects >= 1
            # what an outage costs is counted to one scan or two
            outage = max(np.diff([at for at, _ in rig.got]))
            assert rig.driver.stamper.lost == pytest.approx(outage / 13.32e-3, abs=30)


def test_a_scanner_that_hears_nothing_for_a_while_is_left_well_all_the_same(tmp_path):
    with rigs(tmp_path, {'lms': ()}) as (ports, made):
        rig = made['lms']
        wait(lambda: len(rig.got) > 20, 'scans')
        inject(ports, rig, Fault('miss', duration=1.5))
        injected = threading.Event()
        ports.post(injected.set)
        assert injected.wait(60.0)
    assert (rig.device.memory.mode, rig.device.memory.rate) == (ON_REQUEST, 9600)


@pytest.mark.parametrize('rate, streaming', [(9600, False), (38400, True), (500000, True)])
def test_a_scanner_is_found_at_any_rate_and_taken_over_while_it_streams(
        tmp_path, rate, streaming):
    # requests missed or garbled at first are sent again
    plan = [Fault('miss', duration=0.3), Fault('nak', at=0.5, duration=0.2)]
    with rigs(tmp_path, {'lms': plan}, rate, streaming) as (_, made):
        rig = made['lms']
        wait(lambda: len(rig.got) > 20, 'scans')
        assert (rig.device.memory.rate, rig.device.memory.mode) == (500000, EVERY_TURN)
        assert rig.device.memory.writes == 1            # for the real-time indices
    check_published(rig)
    assert (rig.device.memory.rate, rig.device.memory.mode) == (9600, ON_REQUEST)
    with rigs(tmp_path, {'lms': ()}, serial_baud=38400, real_time_index=False) as (_, made):
        rig = made['lms']
        wait(lambda: len(rig.got) > 5, 'scans without indices')
        assert rig.device.memory.writes == 0
        assert rig.got[0][1].scan_time == pytest.approx(8 * 13.32e-3, rel=1e-3)
    check_published(rig)


@pytest.mark.parametrize('wanted, first, increment', [
    ({'model': 'LMS291-S14'}, {45.0}, 18.5e-6),
    ({'model': 'LMS291-S14', 'stream': 'remission'}, {45.0}, 18.5e-6),
    ({'stream': 'remission', 'angle_min': -0.5, 'angle_max': 0.5}, {61.0}, 37.0e-6),
    ({'model': 'LMS211', 'resolution': 0.5}, {0.0, 0.5}, 37.0e-6),
    ({'resolution': 0.5}, {0.0, 0.5}, 37.0e-6),
    ({'resolution': 0.25}, {0.0, 0.25, 0.5, 0.75}, 37.0e-6),
    ({'stream': 'scans', 'resolution': 0.5, 'scan_angle': 100}, {40.0}, 0.0),
    ({'stream': 'scans', 'angle_min': -0.5, 'angle_max': 0.5}, {61.0}, 37.0e-6)])
def test_streams_of_every_kind(tmp_path, wanted, first, increment):
    with rigs(tmp_path, {'lms': ()}, **wanted) as (_, made):
        rig = made['lms']
        wait(lambda: len(rig.got) > 20, 'scans')
    assert {timed.scan.first for _, timed in rig.got} == first
    assert rig.got[0][1].time_increment == pytest.approx(increment, rel=2e-3)
    intensities = rig.got[0][1].scan.intensities
    assert (intensities is not None) == (wanted.get('stream') == 'remission')
    assert intensities is None or np.all(np.diff(intensities) >= 0) and np.ptp(intensities) > 10
    if wanted.get('stream') != 'scans' or 'angle_min' in wanted:
        check_published(rig)


def test_stamps_stay_true_while_the_arrival_jitters(tmp_path):
    plan = [Fault('jitter', duration=1e3, share=0.5)]
    with rigs(tmp_path, {'lms': plan}) as (_, made):
        rig = made['lms']
        wait(lambda: len(rig.got) > 7 * 75, 'seven seconds')
    late = rig.stamp_errors()[5 * 75:]
    # 0.02 ms of the clock's own, and by what emulator and driver, in one process here, are late
    # at their most timely; the jitter is some 5 ms
    assert np.sqrt(np.mean(late**2)) < 1e-3
    assert rig.driver.stamper.clock.arrival_jitter.rms > 1e6


class Scripted:
    """A port that answers requests from a table, and whatever else it is told to send."""

    def __init__(self, **replies: deque[bytes]) -> None:
        self.replies, self.requests = replies, []
        self.timeout = 0.0
        self._out = bytearray()
        self._parser = Parser(answers=False)

    def write(self, data: bytes) -> int:
        for item in self._parser.feed(data, 0):
            request = requests.decode_request(item.telegram.payload)
            self.requests.append(request)
            replies = self.replies.get(type(request).__name__)
            if replies:
                self._out += replies.popleft()
        return len(data)

    def read(self, size: int = 1) -> bytes:
        data = bytes(self._out[:size])
        del self._out[:size]
        if not data:
            time.sleep(min(self.timeout, 0.01))
        return data

    @property
    def in_waiting(self) -> int:
        return len(self._out)


def answered(answer: object) -> bytes:
    return bytes((ACK,)) + frame(answer.encode(), 0x80)


def test_a_request_is_sent_again_after_silence_a_nak_and_damage():
    good = answered(answers.TypeAnswer('LMS200;301063;V02.10 '))
    damaged = good[:-1] + bytes((good[-1] ^ 1,))
    port = Scripted(ReadType=deque([bytes((NAK,)), damaged, good]))
    device = Device(Line(port))
    assert device.ask(requests.ReadType(), answers.TypeAnswer).text.startswith('LMS200')
    assert device.retries == 2 + 1 - 1
    port = Scripted()
    with pytest.raises(NoAnswerError, match=r'port: no answer to ReadStatus\(\)'):
        Device(Line(port)).ask(requests.ReadStatus(), Status)
    assert len(port.requests) == 3


def test_an_answer_that_cuts_a_scan_is_taken_though_nothing_comes_after_it():
    scan = frame(samples.Scan(samples.Samples(bytes(362))).encode(), 0x80)
    port = Scripted(SwitchMode=deque([scan[:100] + answered(answers.ModeAnswer())]))
    Device(Line(port)).stop()
    assert len(port.requests) == 1


def test_refusals_are_errors_and_not_retried():
    port = Scripted(SwitchMode=deque([answered(answers.ModeAnswer(1)),
                                      answered(answers.Refused())]))
    device = Device(Line(port, '/dev/x'))
    with pytest.raises(LmsError, match='/dev/x: the scanner refuses mode 0x24'):
        device.switch(requests.SwitchMode(requests.ALL_VALUES))
    with pytest.raises(LmsError, match='the scanner refuses: wrong mode or parameter'):
        device.switch(requests.SwitchMode(requests.ALL_VALUES))
    assert len(port.requests) == 2


def test_a_configuration_that_is_not_kept_is_an_error():
    done = answered(answers.ModeAnswer())
    port = Scripted(
        SwitchMode=deque([done, done]),
        WriteConfiguration=deque([answered(answers.ConfigurationWritten(1, FACTORY))]),
        ReadConfiguration=deque([answered(answers.ConfigurationRead(FACTORY))]))
    with pytest.raises(LmsError, match='did not take the configuration'):
        Device(Line(port)).configure(FACTORY.changed(unit=0))
    assert [type(r).__name__ for r in port.requests] == [
        'SwitchMode', 'WriteConfiguration', 'SwitchMode', 'ReadConfiguration']


def test_waiting_can_be_cancelled():
    with pytest.raises(CancelledError):
        Device(Line(Scripted()), lambda: True).ask(requests.ReadStatus(), Status)


def test_a_port_that_is_gone_says_so():
    class Gone(Scripted):
        def read(self, size: int = 1) -> bytes:
            raise OSError(5, 'Input/output error')

    with pytest.raises(LmsError, match=r'usb0: the port is gone \(.*Input/output error'):
        Line(Gone(), 'usb0').receive(0.1)
    with pytest.raises(LmsError, match='nowhere: no such port'):
        Driver(LmsSettings(serial_port='/nowhere')).connect()


def test_without_a_scanner_the_rates_tried_are_named(tmp_path):
    with rigs(tmp_path, {'lms': [Fault('silence', duration=1e3)]}, attempts=1) as (_, made):
        wait(lambda: made['lms'].failure, 'an error')
        failure, made['lms'].failure = made['lms'].failure, None
    assert 'no LMS 2xx answers at 500000, 9600, 19200, 38400 Bd: is it powered' in str(failure)
