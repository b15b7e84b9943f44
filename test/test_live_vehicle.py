# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The virtual vehicle at true times: what the scanners send and what the truth says agree."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
import re
import threading
import time

from hypothesis import given, strategies
import live
import numpy as np
import pytest
from test_lms_emulator_ports import Host
from test_simulation_scanner import LEVEL, pencil, scene, wall_ahead

from stri_mapping import geometry
from stri_mapping.errors import LmsError, StriMappingError, UsageError
from stri_mapping.lms import requests
from stri_mapping.lms.measuring import MODES
from stri_mapping.lms.requests import SwitchMode
from stri_mapping.lms.samples import Scan
from stri_mapping.lms_emulator.faults import Fault
from stri_mapping.lms_emulator.line import Adapter
from stri_mapping.lms_emulator.model import make_memory
from stri_mapping.lms_emulator.process import EmulatorProcess, Setup, Turns, Want
from stri_mapping.lms_emulator.turns import Mirror
from stri_mapping.simulation.drive import Drive
from stri_mapping.simulation.live import AHEAD, LiveDrive
from stri_mapping.simulation.lms import variant
from stri_mapping.simulation.pilot import Pilot, Trip
from stri_mapping.simulation.scanner import VirtualScanner
from stri_mapping.simulation.scenes import Options
from stri_mapping.simulation.timeline import ACCELERATION, make_timeline, Timeline
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, Vehicle, write_vehicle

FULL = Want(180.0, 1.0)


# -- timeline -------------------------------------------------------------------------------

@given(strategies.floats(0.0, 20.0), strategies.floats(0.5, 60.0), strategies.floats(0.1, 1.0),
       strategies.floats(0.1, 1.0))
def test_scene_time_runs_from_first_to_last_without_a_jump(first, length, rise, fall):
    timeline = Timeline(first, first + length, rise * length, fall * length, begin=5.0)
    t = np.linspace(4.0, timeline.end + 1.0, 20001)
    scene_time, rate = timeline.scene(t), timeline.rate(t)
    assert scene_time[0] == first and scene_time[-1] == pytest.approx(first + length)
    assert np.all((0.0 <= rate) & (rate <= 1.0))
    # the rate is the slope: of a function with slopes to 1 and bends of 1.5 / ramp
    step = t[1] - t[0]
    bend = 1.5 / (min(rise, fall) * length)
    between = np.diff(scene_time) / step
    np.testing.assert_allclose(between, 0.5 * (rate[1:] + rate[:-1]), atol=bend * step)


def test_a_vehicle_that_waits_stands_still():
    timeline = Timeline(3.0, 9.0, 2.0, 2.0)
    assert set(timeline.scene([0.0, 1e6])) == {3.0}
    assert set(timeline.rate([0.0, 1e6])) == {0.0}


def test_it_speeds_up_and_slows_down_as_a_car_does():
    motion = scene(wall_ahead(900.0), (20.0, 0, 0, 0, 0, 0), 40.0).motion
    timeline = replace(make_timeline(motion, 0.0, 40.0), begin=0.0)
    t = np.linspace(0.0, timeline.end, 4000)
    speed = motion.twist(timeline.scene(t))[:, 0] * timeline.rate(t)
    assert speed.max() == pytest.approx(20.0)
    assert np.abs(np.gradient(speed, t)).max() <= ACCELERATION * 1.01


# -- casting ahead --------------------------------------------------------------------------

def driving(velocity=(8.0, 0.5, 0.0, 0.0, 0.0, 0.1), duration=6.0) -> LiveDrive:
    """Return a vehicle with one scanner of pencil beams without noise, before a wall."""
    place = scene(wall_ahead(60.0, half=300.0), velocity, duration)
    model = pencil(noise=0.0, reach=1e4)
    scanner = VirtualScanner(LEVEL, model, place, 1, 0)
    return LiveDrive(Drive(place, Vehicle((LEVEL,)), (scanner,), 1))


def cast_all(vehicle: LiveDrive, until: float) -> list[Turns]:
    """Return the batches that are cast as time passes in steps of 50 ms."""
    found = []
    for now in np.arange(0.0, until, 0.05):
        while (turns := vehicle.cast(float(now))) is not None:
            found.append(turns)
    return found


def test_rays_cast_ahead_meet_the_world_from_the_pose_that_the_truth_has_at_their_times():
    vehicle = driving()
    scanner = vehicle.drive.scanners[0]
    vehicle.want(0, FULL, 0.0)
    vehicle.cast(0.0)
    vehicle.go(1.0)
    batches = cast_all(vehicle, vehicle.timeline.end + 0.5)
    bearings = np.deg2rad(np.arange(-90.0, 90.5))
    moved = 0.0
    for turns in batches:
        numbers = turns.first + np.arange(len(turns.ranges))
        times = scanner.phase + scanner.period * (
            numbers[:, None] + (np.arange(181.0) / 360.0)[None, :])
        poses, _ = vehicle.poses(times.ravel())
        ranges = np.array(turns.ranges, dtype=float)
        hit = np.isfinite(ranges.ravel())
        towards = np.stack([np.cos(bearings), np.sin(bearings)], -1)
        points = np.where(np.isfinite(ranges), ranges, 0.0)[..., None] * towards
        world = geometry.compose(poses[hit][:, [0, 1, 5]], np.column_stack(
            [points.reshape(-1, 2)[hit], np.zeros(np.count_nonzero(hit))]))
        assert np.count_nonzero(hit) > 1000
        # half a step of 0.1 mm, and single precision
        np.testing.assert_allclose(world[:, 0], 60.0, atol=0.5e-4 + 1e-5)
        moved = max(moved, float(poses[-1, 0]))
    assert moved > 40.0


def test_the_truths_velocity_is_the_poses_derivative():
    vehicle = driving((8.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    vehicle.go(1.0)
    t = np.linspace(0.0, vehicle.timeline.end + 1.0, 5001)
    poses, twists = vehicle.poses(t)
    np.testing.assert_allclose(np.gradient(poses[:, 0], t), twists[:, 0], atol=0.02)
    assert twists[0, 0] == twists[-1, 0] == 0.0
    assert poses[-1, 0] == pytest.approx(48.0)


def test_casting_is_ahead_by_a_second_in_order_without_a_gap_and_only_for_who_streams():
    vehicle = driving()
    assert vehicle.cast(0.0) is None
    vehicle.want(0, FULL, 0.0)
    batches = cast_all(vehicle, 3.0)
    firsts = np.array([b.first for b in batches])
    assert np.all(np.diff(firsts) == len(batches[0].ranges))
    assert 3.0 < (firsts[-1] + len(batches[-1].ranges)) * 0.01332 - AHEAD < 3.5
    vehicle.want(0, None, 3.0)
    assert vehicle.cast(10.0) is None
    # taken up again at the present, not where it was left
    vehicle.want(0, FULL, 10.0)
    turns = vehicle.cast(10.0)
    assert turns is not None and turns.first == pytest.approx(10.0 / 0.01332, abs=1)


def test_on_the_drive_a_driver_that_comes_back_finds_its_scans():
    vehicle = driving()
    vehicle.want(0, FULL, 0.0)
    vehicle.go(0.0)
    vehicle.cast(0.0)
    vehicle.want(0, None, 0.5)
    assert vehicle.cast(0.5) is not None


def test_what_a_host_sets_is_what_is_cast():
    vehicle = driving()
    vehicle.want(0, Want(100.0, 0.5), 0.0)
    turns = vehicle.cast(0.0)
    assert turns is not None
    assert {len(r) for r in turns.ranges} == {101, 100}
    assert turns.want.first_bearing(0) == -50.0 and turns.want.first_bearing(1) == -49.5


def test_it_does_not_begin_to_move_in_what_is_cast_already():
    vehicle = driving()
    vehicle.want(0, FULL, 0.0)
    while vehicle.cast(0.0) is not None:
        pass
    vehicle.go(0.0)
    assert AHEAD <= vehicle.timeline.begin < AHEAD + 0.5


# -- behind ptys ----------------------------------------------------------------------------

def one_scanner() -> Vehicle:
    vehicle = load_vehicle(default_vehicle_file())
    return Vehicle((vehicle.horizontal,))


class Stream(threading.Thread):
    """Makes a scanner send every turn, and keeps what comes with its times until it vanishes."""

    def __init__(self, path: Path) -> None:
        super().__init__(daemon=True)
        self.path, self.scans, self.over = path, [], False
        self.start()

    def run(self) -> None:
        live.wait_until(self.path.exists, 'the port')
        host = Host(self.path, 9600)
        host.ask(SwitchMode(requests.INSTALLATION, requests.PASSWORD))
        block = host.ask(requests.ReadConfiguration())[1:-1]
        indexed = block[:4] + b'\x02' + block[5:]
        assert host.ask(requests.WriteConfiguration(indexed))[1] == 1
        host.ask(SwitchMode(requests.ON_REQUEST))
        host.ask(SwitchMode(requests.RATES[500000]))
        host.set_rate(500000)
        host.ask(requests.SetVariant(180, 100))
        host.ask(SwitchMode(requests.EVERY_TURN))
        try:
            while (data := host.read(2.0)) and not self.over:
                now = time.monotonic()
                for item in host.parser.feed(data, 0):
                    self.scans.append((now, Scan.decode(item.telegram.payload)))
        except OSError:
            pass
        host.close()


@contextmanager
def trip(tmp_path: Path, **more):
    """Give a trip of one scanner over a second of street, and its stream."""
    given = Trip('street', Options(duration=1.0), one_scanner(), variant('180x1'),
                 tmp_path / 'ports', settle=0.2, linger=0.2)
    yield replace(given, **more)


def test_what_comes_over_the_line_is_what_was_cast_for_that_turn(tmp_path):
    with trip(tmp_path) as given:
        stream = Stream(given.ports / 'horizontal')
        pilot = Pilot(given)
        pilot.run(lambda: False)
        stream.over = True
        stream.join()
    assert pilot.phase == 'over'
    assert pilot.starved == 0
    assert pilot.state.lateness.count > 100
    assert float((given.ports / 'elapsed').read_text()) == pytest.approx(1.0, abs=0.2)
    scanner = pilot.live.drive.scanners[0]
    assert len(stream.scans) > 100          # a second of the scene, speeding up and slowing down
    during = [(came, scan) for came, scan in stream.scans
              if came < pilot.epoch + pilot.live.timeline.end]
    for came, scan in during[::10]:
        # the turn whose end was last, of those with this index
        latest = (came - pilot.epoch - scanner.phase) / scanner.period - 1.0
        turn = int(latest - (int(latest) - scan.indices.turn) % 256)
        # 372 bytes and the adapter; the rest is for a host that was kept waiting
        assert 0.0 <= latest - turn < 60.0
        exact = scanner.turns(turn, turn + 1)[0].scan.ranges
        read = MODES[0].ranges(scan.samples.words, 0)
        np.testing.assert_array_equal(np.isfinite(read), np.isfinite(exact))
        near = np.isfinite(exact)
        np.testing.assert_allclose(read[near], exact[near], atol=0.005 + 1e-5)


def test_a_scanner_that_nobody_makes_stream_is_named(tmp_path):
    with trip(tmp_path, patience=0.1) as given, pytest.raises(
            StriMappingError, match='no driver has made horizontal stream from'):
        Pilot(given).run(lambda: False)
    live.wait_until(lambda: not (given.ports / 'horizontal').is_symlink(), 'the port to vanish')


def test_without_waiting_it_drives_on_its_own_and_from_where_it_was(tmp_path):
    with trip(tmp_path, wait=False, resume=True) as given:
        given.ports.mkdir()
        (given.ports / 'elapsed').write_text('0.700\n')
        pilot = Pilot(given)
        pilot.run(lambda: False)
    assert pilot.phase == 'over'
    assert pilot.live.timeline.first == 0.7


def test_a_plan_for_a_scanner_that_is_not_there_is_refused(tmp_path):
    with trip(tmp_path, faults={'rear': [Fault('crc')]}) as given, pytest.raises(
            UsageError, match='faults of "rear": the scanners are horizontal'):
        Pilot(given).run(lambda: False)


def test_a_process_that_cannot_make_its_ports_says_so(tmp_path):
    (tmp_path / 'horizontal').write_text('mine')
    setup = Setup('horizontal', Mirror(time.monotonic()), make_memory('LMS291'))
    with EmulatorProcess(tmp_path, [setup], Adapter()) as process:
        def failed() -> bool:
            with pytest.raises(LmsError, match='is there already and no link'):
                live.wait_until(lambda: process.poll(0.1) and False, 'the failure')
            return True
        assert failed()


# -- the node -------------------------------------------------------------------------------

@live.needs_ros
def test_the_node_drives_tells_the_truth_and_goes_on_after_a_kill(tmp_path):
    from nav_msgs.msg import Odometry
    write_vehicle(tmp_path / 'vehicle.yaml', one_scanner())
    parameters = {'scene': 'street', 'duration': 1.5, 'ports': tmp_path / 'ports', 'settle': 0.3,
                  'linger': 0.2, 'vehicle_file': tmp_path / 'vehicle.yaml'}
    elapsed = tmp_path / 'ports' / 'elapsed'
    with live.listener() as (node, executor, env):
        poses: list[Odometry] = []
        node.create_subscription(Odometry, '/ground_truth/odom', poses.append, live.lossless())
        with live.node('virtual_vehicle', parameters, env) as killed:
            Stream(tmp_path / 'ports' / 'horizontal')
            live.spin_until(executor, lambda: elapsed.exists()
                            and float(elapsed.read_text()) > 0.2, 'the drive to begin')
            killed.kill()
            killed.communicate(timeout=live.TIMEOUT)
        live.wait_until(lambda: not (tmp_path / 'ports' / 'horizontal').is_symlink(),
                        'the port to vanish')
        with live.node('virtual_vehicle', {**parameters, 'resume': True}, env) as vehicle:
            Stream(tmp_path / 'ports' / 'horizontal')
            live.spin_until(executor, lambda: vehicle.poll() is not None
                            and poses[-1].twist.twist.linear.x == 0.0, 'the end')
            output, _ = vehicle.communicate(timeout=live.TIMEOUT)
    assert vehicle.returncode == 0, output
    assert 'scans sent, 0 left out; bytes were late by' in output
    stamps = np.array([p.header.stamp.sec * 10**9 + p.header.stamp.nanosec for p in poses])
    killed_at = int(np.argmax(np.diff(stamps))) + 1         # seconds, to start anew
    assert set(np.diff(stamps[killed_at:])) == {10_000_000}
    xyz = np.array([[p.pose.pose.position.x, p.pose.pose.position.y] for p in poses])
    # it stands where it was killed: what it kept of that, and the last truth, are 0.1 s old or so
    assert abs(xyz[killed_at - 1, 0] - xyz[killed_at, 0]) < 0.3 * 8.4
    xyz = xyz[killed_at:]
    speeds = np.array([p.twist.twist.linear.x for p in poses])[killed_at:]
    assert speeds[0] == speeds[-1] == 0.0 and speeds.max() > 1.0
    # all of the drive is driven, by the poses and by their velocities
    path = np.hypot(*np.diff(xyz, axis=0).T).sum()
    assert path == pytest.approx(0.01 * speeds.sum(), rel=0.01)


@live.needs_ros
@pytest.mark.parametrize(('given', 'words'), [
    ({'ports': 'p'}, 'parameter scene is missing'),
    ({'scene': 'street'}, 'parameter ports is missing'),
    ({'scene': 'street', 'ports': 'p', 'variant': '7'}, 'unknown scanner variant "7"'),
    ({'scene': 'street', 'ports': 'p', 'traffic': -1.0}, 'traffic is -1.0, want 0.0 to 10.0'),
    ({'scene': 'street', 'ports': 'p', 'faults': '/none.yaml'}, '/none.yaml: No such file'),
])
def test_the_node_refuses_what_cannot_be(given, words):
    from stri_mapping.nodes.virtual_vehicle import VirtualVehicleSettings
    with pytest.raises(UsageError, match=re.escape(words)):
        VirtualVehicleSettings(**given).trip()


@live.needs_ros
def test_the_node_ends_with_one_line_where_a_scene_is_unknown(tmp_path):
    given = {'scene': 'moon', 'ports': tmp_path}
    with live.node('virtual_vehicle', given, live.environment()) as vehicle:
        output, _ = vehicle.communicate(timeout=live.TIMEOUT)
    assert vehicle.returncode == 2
    assert 'ERROR: unknown scene "moon"; known are campus' in output
    assert 'Traceback' not in output
