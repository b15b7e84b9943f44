# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""`run` on the vehicle, and on a virtual one whose bytes come over pseudo-terminals."""

from __future__ import annotations

import json
from pathlib import Path

import live
import pytest
import yaml

from stri_mapping.bag_io import Bag
from stri_mapping.summary import read_summary
from stri_mapping.vehicle import default_vehicle_file

pytestmark = live.needs_ros


def test_on_the_vehicle_it_waits_for_scanners_and_ctrl_c_is_its_good_end(tmp_path):
    vehicle = yaml.safe_load(default_vehicle_file().read_text(encoding='utf-8'))
    for scanner in vehicle['scanners']:
        scanner['port'] = {'serial_port': str(tmp_path / f'no-{scanner["name"]}')}
    path = tmp_path / 'vehicle.yaml'
    path.write_text(yaml.safe_dump(vehicle), encoding='utf-8')
    with live.command('run', '--vehicle', path, '--output', tmp_path / 'out',
                      env=live.environment()) as process:
        def drivers() -> int:
            return sum(b'sick_lms_driver' in Path(f'/proc/{pid}/cmdline').read_bytes()
                       for pid in live.node_pids(process.pid))

        live.wait_until(lambda: drivers() == 4, 'the drivers')      # the last to be started
        process.send_signal(2)
        output, _ = process.communicate(timeout=live.TIMEOUT)
        assert process.returncode == 0, output
        assert live.node_pids(process.pid) == []
    assert 'Traceback' not in output
    assert read_summary(tmp_path / 'out')['scans'] == 0


def test_a_virtual_drive_goes_by_wire_through_all_nodes_into_bag_and_results(tmp_path):
    pytest.importorskip('embreex', reason='pip install stri_mapping[simulation]')
    code, output = live.shown(
        ['run', '--simulate', 'street', '--duration', 4, '--record', tmp_path / 'bag', '--output',
         tmp_path / 'out'], live.environment())
    assert code == 0, output
    assert 'Traceback' not in output
    summary = read_summary(tmp_path / 'out')
    assert summary['complete'] is True
    assert summary['points'] > 0
    assert len(summary['scanners']) == 4
    with Bag(tmp_path / 'bag') as bag:
        assert {'/horizontal/scan', '/vertical_fore/scan', '/vertical_side/scan',
                '/vertical_aft/scan', '/ground_truth/odom', '/odom'} <= set(bag.topics)
        assert not any(topic.startswith(('/facade', '/stri/')) for topic in bag.topics)
    code, output = live.shown(['evaluate', tmp_path / 'out', '--truth', tmp_path / 'bag'],
                              live.environment())
    assert code == 0, output
    found = json.loads((tmp_path / 'out/evaluation.json').read_text(encoding='utf-8'))['errors']
    # 15 m of path: stamps, mounts and truth belong together
    assert found['drift_percent'] < 3.0


@pytest.mark.parametrize('options, said', [
    (['--rate', '2'], '--rate goes with --bag only'),
    (['--seed', '2'], '--seed goes with --simulate only'),
    (['--simulate', 'nowhere'], '--simulate nowhere: want one of'),
    (['--simulate', 'street', '--duration', '-1'], '--duration is -1'),
])
def test_options_without_effect_are_refused(options, said, tmp_path, capsys, monkeypatch):
    from stri_mapping import cli
    monkeypatch.chdir(tmp_path)
    assert cli.main(['run', *options]) == 2
    assert said in capsys.readouterr().err
    assert list(Path().iterdir()) == []
