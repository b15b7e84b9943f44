# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The player at hand: pause, step, rate, start, loops, and what loops do to the others."""

from __future__ import annotations

from pathlib import Path

import live
import numpy as np
import pytest

from stri_mapping.bag_io import Bag
from stri_mapping.facade.cloud_files import count_points
from stri_mapping.scan import stamp_ns
from stri_mapping.summary import read_summary
from stri_mapping.trajectory import read_tum

pytestmark = [live.needs_ros, pytest.mark.skipif(
    not live.CAMPUS.is_dir(), reason=f'{live.CAMPUS} is not there')]

TOPIC = '/horizontal/scan'


@pytest.fixture(scope='module')
def short_bag(tmp_path_factory) -> Path:
    return live.cut_bag(live.CAMPUS, tmp_path_factory.mktemp('bags') / 'short', 4.0)


def called(own, executor, kind, name: str, request):
    """Call a service of the player and return its answer."""
    client = own.create_client(kind, name)
    live.spin_until(executor, client.service_is_ready, name)
    future = client.call_async(request)
    live.spin_until(executor, future.done, f'the answer of {name}')
    return future.result()


def test_it_pauses_steps_and_changes_its_rate(short_bag):
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters
    from sensor_msgs.msg import LaserScan
    from std_srvs.srv import SetBool, Trigger
    with Bag(short_bag) as bag:
        sent = [bytes(data) for _, _, data in bag.raw_messages([TOPIC])]
    got: list[bytes] = []
    with live.listener() as (own, executor, env):
        own.create_subscription(LaserScan, TOPIC, lambda data: got.append(bytes(data)),
                                live.lossless(), raw=True)
        parameters = {'bag': short_bag, 'rate': 0.02, 'topics': TOPIC, 'subscribers': TOPIC}
        with live.node('bag_player', parameters, env) as player:
            live.spin_until(executor, lambda: got, 'the first scan')
            assert called(own, executor, SetBool, '/bag_player/pause',
                          SetBool.Request(data=True)).success
            paused = len(got)
            for number in range(3):
                assert called(own, executor, Trigger, '/bag_player/step',
                              Trigger.Request()).success
                live.spin_until(executor, lambda n=number: len(got) == paused + n + 1, 'a scan')
            value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=50.0)
            answer = called(own, executor, SetParameters, '/bag_player/set_parameters',
                            SetParameters.Request(parameters=[
                                Parameter(name='rate', value=value)]))
            assert answer.results[0].successful
            for name, wrong in (('rate', -1.0), ('start', 2.0)):    # out of range, read-only
                value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=wrong)
                answer = called(own, executor, SetParameters, '/bag_player/set_parameters',
                                SetParameters.Request(parameters=[
                                    Parameter(name=name, value=value)]))
                assert not answer.results[0].successful
                assert answer.results[0].reason
            called(own, executor, SetBool, '/bag_player/pause', SetBool.Request(data=False))
            live.spin_until(executor, lambda: player.poll() is not None, 'the end')
            live.spin_until(executor, lambda: len(got) == len(sent), 'all scans')
            assert player.returncode == 0
    assert got == sent


def test_it_begins_and_ends_where_it_is_told_and_mounts_come_all_the_same(short_bag):
    code, output = live.shown(['play', short_bag, '--rate', 0, '--start', 2.0, '--duration', 1.0],
                              live.environment())
    assert code == 0, output
    # a second of scans: 75 of them
    assert f'75 {TOPIC}' in output or f'76 {TOPIC}' in output
    if live.find_spec('tf2_msgs'):
        assert '1 /tf_static' in output


def test_a_loop_gives_the_same_odometry_again_and_keeps_the_first_results(short_bag, tmp_path):
    from nav_msgs.msg import Odometry
    odometry: list[tuple[int, float]] = []
    with live.listener() as (own, executor, env):
        own.create_subscription(
            Odometry, 'odom', lambda m: odometry.append(
                (stamp_ns(m.header.stamp), m.pose.pose.position.x)), live.lossless())
        given = {'output': tmp_path, 'use_sim_time': True, 'tf_static_wait': 0.0}
        with live.node('stri_estimator', given, env) as estimator, live.node(
                'facade_aligner', given, env) as aligner, live.node(
                'bag_player', {'bag': short_bag, 'loop': True, 'rate': 0.0, 'follow': 'odom',
                               'subscribers': f'{TOPIC} /vertical_side/scan'}, env) as player:
            def passes() -> int:
                return 1 + sum(b[0] < a[0] for a, b in zip(odometry, odometry[1:]))

            live.spin_until(executor, lambda: passes() == 3, 'the third pass')
            for process in (player, estimator, aligner):
                process.send_signal(2)
            live.spin_until(executor, lambda: all(
                p.poll() is not None for p in (player, estimator, aligner)), 'the end')
            outputs = [p.communicate()[0] for p in (player, estimator, aligner)]
    assert not any('Traceback' in output for output in outputs)
    assert 'time was set back' in outputs[1]
    assert 'time was set back' in outputs[2]
    begins = [0, *(i + 1 for i, (a, b) in enumerate(zip(odometry, odometry[1:])) if b[0] < a[0])]
    assert odometry[:begins[1]] == odometry[begins[1]:begins[2]]
    with Bag(short_bag) as bag:
        scans = bag.message_count(TOPIC)
    path = read_tum(tmp_path / 'trajectory.tum')
    assert len(path) == scans == read_summary(tmp_path)['scans']
    assert np.all(np.diff(path.stamps_ns) > 0)
    offline = live.map_offline(short_bag, tmp_path / 'offline')
    assert count_points(tmp_path / 'facade.ply') == pytest.approx(
        count_points(offline / 'facade.ply'), rel=0.001)
