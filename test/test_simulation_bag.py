# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
import json
from pathlib import Path

import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.bag_io import Bag, select_scanners, TRUTH_TOPIC
from stri_mapping.bag_writer import BagWriter
from stri_mapping.cli import main
from stri_mapping.simulation.drive import make_drive, simulate
from stri_mapping.simulation.mesh import write_ply
from stri_mapping.simulation.scenes import make_scene, Options
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

CAMPUS = Path(__file__).parent.parent / 'bags' / 'campus'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('bags') / 'stops'
    assert main(['simulate', 'stops', '--output', str(path), '--seed', '7',
                 '--duration', '1.2']) == 0
    return path


def test_bag_holds_the_scans_in_the_order_of_their_arrival(bag):
    expected, _ = simulate('stops', Options(7, 1.2))
    vehicle = load_vehicle(default_vehicle_file())
    with Bag(bag) as recorded:
        scanners = select_scanners(recorded, vehicle)
        got = list(recorded.scans(scanners.scanners))
        logged = [log for _, log, _ in recorded.messages([s.topic for s in scanners.scanners])]
    assert logged == [t.arrival_ns for t in expected]
    for timed, (scanner, scan) in zip(expected, got, strict=True):
        assert scanner.name == timed.scanner.name and scan.stamp_ns == timed.scan.stamp_ns
        for field in ('ranges', 'angles', 'times'):
            assert np.array_equal(getattr(scan, field), getattr(timed.scan, field)), field
        assert (scan.intensities is None) == (scanner.role == 'horizontal')
        if scan.intensities is not None:
            assert np.array_equal(scan.intensities, timed.scan.intensities)


def test_bag_holds_mounts_and_truth(bag):
    vehicle = load_vehicle(default_vehicle_file())
    drive = make_drive('stops', Options(7, 1.2))
    with Bag(bag) as recorded:
        mounts = recorded.static_transforms()
        truth = recorded.odometry(TRUTH_TOPIC)
        odometry = [m for _, _, m in recorded.messages([TRUTH_TOPIC])]
    for scanner in vehicle.scanners:
        assert np.allclose(mounts['base_link', scanner.frame], scanner.T_base_laser, atol=1e-12)
    assert np.allclose(truth.poses, drive.truth().poses, atol=1e-9)
    assert np.array_equal(truth.stamps_ns, drive.truth().stamps_ns)
    times = drive.truth_times()
    for message, pose, twist in zip(odometry, drive.scene.motion.at(times),
                                    drive.scene.motion.twist(times), strict=True):
        q, p = message.pose.pose.orientation, message.pose.pose.position
        R = geometry.rotation_from_quat((q.x, q.y, q.z, q.w))
        assert np.allclose(R, geometry.rotation_from_rpy(*pose[3:]), atol=1e-9)
        assert np.allclose((p.x, p.y, p.z), pose[:3])
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        assert np.allclose((linear.x, linear.y, linear.z, angular.x, angular.y, angular.z), twist)


def test_same_seed_gives_the_same_bytes_and_another_does_not(bag, tmp_path):
    for seed, same in ((7, True), (8, False)):
        again = tmp_path / str(seed) / 'stops'
        assert main(['simulate', 'stops', '--output', str(again), '--seed', str(seed),
                     '--duration', '1.2']) == 0
        files = sorted(f.name for f in bag.iterdir())
        assert files == ['metadata.yaml', 'scene.json', 'stops.mcap', 'surfaces.ply']
        assert all((again / f).read_bytes() == (bag / f).read_bytes() for f in files) == same


def test_scene_facts_and_surfaces_lie_beside_the_recording(bag):
    facts = json.loads((bag / 'scene.json').read_text())
    assert facts['scene'] == 'stops' and facts['seed'] == 7 and facts['walls']
    assert (bag / 'surfaces.ply').read_bytes().startswith(b'ply\nformat binary_little_endian')


def test_surfaces_can_be_read_by_others(tmp_path):
    plyfile = pytest.importorskip('plyfile')
    mesh = make_scene('campus').mesh
    write_ply(tmp_path / 'mesh.ply', mesh)
    ply = plyfile.PlyData.read(tmp_path / 'mesh.ply')
    vertices = np.column_stack([ply['vertex'][c] for c in 'xyz'])
    faces = np.vstack(ply['face']['vertex_indices'])
    assert np.array_equal(vertices[faces], mesh.triangles)
    brightness = np.array([s.reflectance for s in mesh.surfaces])[mesh.surface]
    assert np.allclose(ply['face']['reflectance'], brightness)


@pytest.mark.parametrize('arguments, code, text', [
    (['moon', '--output', 'new'], 2, 'unknown scene "moon"'),
    (['street', '--output', 'new', '--variant', '90x1'], 2, 'unknown scanner variant "90x1"'),
    (['street'], 2, '--output is missing'),
    (['street', '--output', 'new', '--duration', '0'], 2, 'duration is 0.0'),
    (['street', '--output', '.'], 1, 'exists already'),
    (['street', '--output', 'new', '--vehicle', 'none.yaml'], 1, 'none.yaml')])
def test_faults_are_one_line(arguments, code, text, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(['simulate', *arguments]) == code
    error = capsys.readouterr().err
    assert text in error and error.count('\n') == 1
    assert not (tmp_path / 'new').exists()


def test_interrupted_recording_is_a_bag(tmp_path, monkeypatch):
    write = BagWriter.scan
    monkeypatch.setattr(BagWriter, 'scan', lambda self, scanner, scan, log_ns: (
        write(self, scanner, scan, log_ns) if log_ns % 10**9 < 5 * 10**8 else interrupt()))
    assert main(['simulate', 'campus', '--output', str(tmp_path / 'cut')]) == 130
    with Bag(tmp_path / 'cut') as cut:
        assert cut.message_count('/horizontal/scan') > 30


def interrupt():
    raise KeyboardInterrupt


def test_list_names_every_scene(capsys):
    assert main(['simulate', 'list']) == 0
    assert 'bare_wall' in capsys.readouterr().out


def test_included_campus_is_the_papers_test():
    size = sum(f.stat().st_size for f in CAMPUS.iterdir())
    assert size <= 8e6
    with Bag(CAMPUS) as recorded:
        truth = recorded.odometry(TRUTH_TOPIC)
        scanners = select_scanners(recorded, load_vehicle(default_vehicle_file()))
        rates = [recorded.message_count(s.topic) / truth.duration for s in scanners.scanners]
    assert len(rates) == 4 and np.allclose(rates, 75.08, atol=0.1)
    assert truth.distance == pytest.approx(170.0, abs=0.1)
    facts = json.loads((CAMPUS / 'scene.json').read_text())
    assert np.allclose(np.diff([c['x'] for c in facts['columns']]), 6.0)


def test_included_campus_is_what_its_seed_gives():
    expected, _ = simulate('campus', Options(1, 1.0))
    with Bag(CAMPUS) as recorded:
        scanners = select_scanners(recorded, load_vehicle(default_vehicle_file()))
        scans = recorded.scans(scanners.scanners)
        for timed, (scanner, scan) in zip(expected, scans):
            assert scan.stamp_ns == timed.scan.stamp_ns and scanner.name == timed.scanner.name
            # processors may round the last bit differently, and a range then falls to the
            # neighbouring centimetre
            assert np.mean(scan.ranges != timed.scan.ranges) < 0.05
