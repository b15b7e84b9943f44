# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The driver node on emulated scanners: lifecycle, messages, and an end that leaves them well."""

from __future__ import annotations

from contextlib import contextmanager
import signal
import time

import live
from lms_rig import Numbered, ranges_of
import numpy as np
import pytest

from stri_mapping.lms.requests import EVERY_TURN, ON_REQUEST
from stri_mapping.lms_emulator.device import EmulatedLms
from stri_mapping.lms_emulator.model import make_memory
from stri_mapping.lms_emulator.ports import Ports, PtyPort
from stri_mapping.lms_emulator.turns import Mirror

pytestmark = live.needs_ros


@contextmanager
def scanner(path, **memory):
    """Give an emulated scanner behind a port."""
    begin = time.monotonic()
    device = EmulatedLms(Numbered(), make_memory('LMS291', **memory), begin=begin,
                         mirror=Mirror(begin, 13.32e-3))
    with Ports((PtyPort(path, device),)):
        yield device


@pytest.fixture
def listener():
    with live.listener() as parts:
        yield parts


def subscribed(node, topic='/scan'):
    from sensor_msgs.msg import LaserScan
    got: list[LaserScan] = []
    node.create_subscription(LaserScan, topic, got.append, live.lossless())
    return got


def diagnosed(node):
    from diagnostic_msgs.msg import DiagnosticArray
    got: list[DiagnosticArray] = []
    node.create_subscription(DiagnosticArray, '/diagnostics', got.append, 10)
    return got


def change(executor, client, transition) -> bool:
    """Ask for a lifecycle transition; return whether it succeeded."""
    from lifecycle_msgs.srv import ChangeState
    request = ChangeState.Request()
    request.transition.id = transition
    future = client.call_async(request)
    live.spin_until(executor, future.done, 'the end of a transition')
    return bool(future.result().success)


def test_it_lives_the_life_of_a_lifecycle_node(listener, tmp_path):
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState
    node, executor, env = listener
    got, diagnostics = subscribed(node), diagnosed(node)
    client = node.create_client(ChangeState, '/sick_lms_driver/change_state')
    parameters = {'serial_port': tmp_path / 'lms', 'frame_id': 'left_laser', 'resolution': 0.5}
    with scanner(tmp_path / 'lms') as device, live.node(
            'sick_lms_driver', parameters, env) as process:
        live.spin_until(executor, client.service_is_ready, 'the node')
        live.spin_until(executor, lambda: diagnostics, 'a report before anything is configured')
        assert diagnostics[0].status[0].message == 'not connected'
        assert change(executor, client, Transition.TRANSITION_CONFIGURE)
        assert (device.memory.mode, device.memory.rate) == (ON_REQUEST, 500000)
        assert change(executor, client, Transition.TRANSITION_ACTIVATE)
        live.spin_until(executor, lambda: len(got) > 150, 'scans')
        live.spin_until(executor, lambda: diagnostics[-1].status[0].message == 'streaming',
                        'a report of streaming')
        assert change(executor, client, Transition.TRANSITION_DEACTIVATE)
        assert device.memory.mode == ON_REQUEST
        count = len(got)
        assert change(executor, client, Transition.TRANSITION_ACTIVATE)
        live.spin_until(executor, lambda: len(got) > count + 20, 'scans after an interruption')
        assert change(executor, client, Transition.TRANSITION_DEACTIVATE)
        assert change(executor, client, Transition.TRANSITION_CLEANUP)
        assert device.memory.rate == 9600
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=live.TIMEOUT)
    assert process.returncode == 0, output
    assert '500000 Bd gives 75.1 Hz' in output and '9600 Bd gives 2.5' in output
    check_messages(got, device)
    check_report(diagnostics)


def check_messages(got, device) -> None:
    """Check every field of the scans of single turns at half a degree."""
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in got])
    assert np.all(np.diff(stamps) > 0)
    offset = time.time() - time.monotonic()
    for message, stamp in zip(got, stamps):
        assert message.header.frame_id == 'left_laser'
        first = np.rad2deg(message.angle_min) + 90.0
        count = 181 if round(first, 3) == 0.0 else 180
        assert len(message.ranges) == count and len(message.intensities) == 0
        assert message.angle_increment == pytest.approx(np.deg2rad(1.0))
        assert message.angle_max == pytest.approx(message.angle_min + np.deg2rad(count - 1))
        assert message.time_increment == pytest.approx(13.32e-3 / 360.0, rel=1e-3)
        assert message.scan_time == pytest.approx(13.32e-3, rel=1e-3)
        assert message.range_max == pytest.approx(81.83)
        bearings = np.rad2deg(message.angle_min) + np.arange(count)
        turn = round(100.0 * (message.ranges[0] - ranges_of(0, bearings[:1])[0]))
        assert np.allclose(message.ranges, ranges_of(turn, bearings), atol=1e-4)
        assert round(first, 3) == (0.5 if turn % 2 else 0.0)
        sent = device.mirror.begin(turn) + 13.32e-3 * first / 360.0
        assert 1e-9 * stamp - offset == pytest.approx(sent, abs=6e-3)


def check_report(diagnostics) -> None:
    """Check the keys that other programs look for."""
    status = next(a.status[0] for a in reversed(diagnostics)
                  if a.status[0].message == 'streaming')
    values = {each.key: each.value for each in status.values}
    assert (status.name, status.hardware_id) == ('sick_lms_driver: scanner', '00000001')
    assert {'Serial Port', 'Serial Baud', 'Vendor Name', 'Product Name', 'Firmware Version',
            'Device ID', 'Computed Latency', 'User Time Offset', 'Rate', 'Scans', 'Lost scans',
            'CRC errors', 'Arrival jitter (ms)', 'Stamp jitter (ms)', 'Window pollution',
            'Error list'} <= set(values)
    assert values['Firmware Version'] == 'V02.10'
    assert float(values['Computed Latency']) == pytest.approx(13.32e-3, rel=1e-3)
    assert int(values['Scans']) > 0


def test_ctrl_c_leaves_the_scanner_waiting_at_9600_baud(listener, tmp_path):
    node, executor, env = listener
    got = subscribed(node)
    parameters = {'serial_port': tmp_path / 'lms', 'self_start': True}
    with scanner(tmp_path / 'lms', rate=38400) as device, live.node(
            'sick_lms_driver', parameters, env) as process:
        live.spin_until(executor, lambda: len(got) > 10, 'scans')
        assert (device.memory.mode, device.memory.rate) == (EVERY_TURN, 500000)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=live.TIMEOUT)
        assert (device.memory.mode, device.memory.rate) == (ON_REQUEST, 9600)
    assert process.returncode == 0, output
    assert 'Traceback' not in output


def test_after_kill_9_a_new_one_takes_over_the_streaming_scanner(listener, tmp_path):
    node, executor, env = listener
    got = subscribed(node)
    parameters = {'serial_port': tmp_path / 'lms', 'self_start': True}
    with scanner(tmp_path / 'lms') as device:
        with live.node('sick_lms_driver', parameters, env) as process:
            live.spin_until(executor, lambda: len(got) > 10, 'scans')
            process.kill()
            process.communicate()
        assert (device.memory.mode, device.memory.rate) == (EVERY_TURN, 500000)
        last, count = got[-1].header.stamp, len(got)
        with live.node('sick_lms_driver', parameters, env) as process:
            live.spin_until(executor, lambda: len(got) > count + 10, 'scans of the new one')
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=live.TIMEOUT)
        assert process.returncode == 0
        assert (device.memory.mode, device.memory.rate) == (ON_REQUEST, 9600)
        assert device.memory.writes == 1
        assert (got[count + 5].header.stamp.sec, got[count + 5].header.stamp.nanosec) > (
            last.sec, last.nanosec)


def test_without_its_port_it_says_so_once_and_keeps_trying(listener, tmp_path):
    node, executor, env = listener
    got, diagnostics = subscribed(node, '/left/scan'), diagnosed(node)
    parameters = {'serial_port': tmp_path / 'lms', 'self_start': True}
    with live.node('sick_lms_driver', parameters, env, '-r', '__ns:=/left') as process:
        live.spin_until(executor, lambda: len(diagnostics) > 1, 'reports')
        assert 'no such port' in diagnostics[-1].status[0].message
        with scanner(tmp_path / 'lms'):
            live.spin_until(executor, lambda: len(got) > 5, 'scans once the port is there')
            process.send_signal(signal.SIGINT)
            output, _ = process.communicate(timeout=live.TIMEOUT)
    assert process.returncode == 0
    assert output.count('no such port') == 1


@pytest.mark.parametrize('parameters, said', [
    ({'serial_baud': 115200}, 'parameter serial_baud is 115200: want one of 9600'),
    ({'serial_baud': 'fast'}, 'parameter serial_baud: want a value such as 500000'),
    ({'latency': 7.0}, 'parameter latency is 7'),
    ({'unit': 'm'}, 'parameter unit is m: want one of keep, cm, mm')])
def test_settings_that_no_scanner_has_end_it_with_one_line(parameters, said):
    with live.node('sick_lms_driver', parameters, live.environment()) as process:
        output, _ = process.communicate(timeout=live.TIMEOUT)
    assert process.returncode == 2
    assert said in output
    assert 'Traceback' not in output


def test_settings_that_this_scanner_does_not_have_end_it_too(tmp_path):
    parameters = {'serial_port': tmp_path / 'lms', 'self_start': True, 'stream': 'scans',
                  'resolution': 0.25}
    with scanner(tmp_path / 'lms'), live.node(
            'sick_lms_driver', parameters, live.environment()) as process:
        output, _ = process.communicate(timeout=live.TIMEOUT)
    assert process.returncode == 2
    assert 'an LMS291 has no 180 deg at 0.25 deg; it has 180 deg at 1 deg' in output
