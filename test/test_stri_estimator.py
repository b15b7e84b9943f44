# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator on the included drive: its accuracy, and symmetries that it must keep."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stri_mapping import geometry
from stri_mapping.bag_io import Bag, select_scanners
from stri_mapping.scan import Scan
from stri_mapping.stri.estimator import StriEstimator
from stri_mapping.stri.joint import JointPath
from stri_mapping.stri.recovery import ACCELERATIONS
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

CAMPUS = Path(__file__).parents[1] / 'bags' / 'campus'
SCANS = 525     # seven seconds, of which the start takes 0.7
STEP = np.diff(np.sort(ACCELERATIONS)).max()    # between accelerations that are tried


@pytest.fixture(scope='module')
def drive():
    with Bag(CAMPUS) as bag:
        vehicle = select_scanners(bag, load_vehicle(default_vehicle_file()))
        scans = []
        for _, scan in bag.scans([vehicle.horizontal]):
            scans.append(scan)
            if len(scans) == SCANS:
                break
        return vehicle.horizontal.T_base_laser, scans, bag.odometry('/ground_truth/odom')


def run(mount, scans):
    estimator = StriEstimator(mount)
    live, final = [], []
    for scan in scans:
        estimate = estimator.add(scan)
        if estimate is not None:
            live.append(estimate)
        final += estimator.take_refined()
    estimator.finish()
    return live, final + estimator.take_refined()


@pytest.fixture(scope='module')
def result(drive):
    return run(drive[0], drive[1])


def poses(estimates):
    return np.array([e.pose for e in estimates])


def test_every_scan_gets_one_final_pose_in_order(drive, result):
    assert [e.stamp_ns for e in result[1]] == [s.stamp_ns for s in drive[1]]
    assert [e.stamp_ns for e in result[0]] == [s.stamp_ns for s in drive[1][-len(result[0]):]]
    np.testing.assert_allclose(result[1][0].pose, 0.0, atol=1e-6)


def test_the_path_is_the_true_one(drive, result):
    truth = drive[2].at([e.stamp_ns for e in result[1]])
    truth = geometry.compose(geometry.inverse(truth[0]), truth)
    error = poses(result[1]) - truth
    travelled = np.hypot(*np.diff(truth[:, :2], axis=0).T).sum()
    # 0.1 % of the way, and 1.2 cm: pitch of 0.25 deg moves the scanner, 1.2 m up, by 5 mm
    # against base_link, three standard deviations of it count
    assert np.hypot(*error[-1, :2]) < 0.001 * travelled + 0.015
    assert np.abs(error[:, 2]).max() < np.deg2rad(0.1)


def test_the_newest_estimates_are_near_the_final_ones(result):
    final = {e.stamp_ns: e for e in result[1]}
    live = result[0][100:]
    shift = np.array([e.pose[:2] - final[e.stamp_ns].pose[:2] for e in live])
    speed = np.array([e.twist[0] - final[e.stamp_ns].twist[0] for e in live])
    # extrapolated by up to 0.1 s: accelerations here stay below 1 m/s^2
    assert np.abs(shift).max() < 0.03
    assert np.abs(speed).max() < 0.25


def test_a_shift_in_time_changes_nothing(drive, result):
    # whole seconds: the fractions of all stamps stay what they are
    later = [replace(s, stamp_ns=s.stamp_ns + 7 * 10**9) for s in drive[1]]
    np.testing.assert_allclose(poses(run(drive[0], later)[1]), poses(result[1]), atol=1e-9)


def test_a_drive_that_outgrows_its_room_goes_on_unchanged(drive, result, monkeypatch):
    # knots every 0.1 s: room is made again every 2 s instead of every hour
    monkeypatch.setattr('stri_mapping.stri.joint.ROOM', 20)
    monkeypatch.setattr('stri_mapping.stri.joint.RECENT', 25)
    assert drive[1][-1].stamp_ns - drive[1][0].stamp_ns > 6e9
    np.testing.assert_array_equal(poses(run(*drive[:2])[1]), poses(result[1]))


def test_another_mount_gives_the_same_motion(drive, result):
    # base_link half a metre further ahead, and the scanner's zero ray 40 degrees further left
    turn = np.deg2rad(40.0)
    T_new_base = geometry.transform([-0.5, 0.2, 0.3], [0.0, 0.0, 0.0])
    mount = T_new_base @ drive[0] @ geometry.transform([0.0, 0.0, 0.0], [0.0, 0.0, turn])
    scans = [replace(s, angles=s.angles - turn) for s in drive[1]]
    moved = poses(run(mount, scans)[1])
    A = np.array([-0.5, 0.2, 0.0])
    expected = geometry.compose(geometry.compose(A, poses(result[1])), geometry.inverse(A))
    # bins of bearing begin elsewhere, so partners differ where two are equally near: what
    # remains must lie within the estimate's own noise, which is 1 cm and 0.03 deg here
    assert np.abs(moved - expected)[:, :2].max() < 0.01
    assert np.abs(moved - expected)[:, 2].max() < np.deg2rad(0.03)


def test_a_scanner_mounted_upside_down_gives_the_same_motion(drive, result):
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    scans = [Scan(s.stamp_ns, s.ranges[::-1].copy(), -s.angles[::-1], s.times[::-1].copy(),
                  None, s.range_min, s.range_max) for s in drive[1]]
    turned = poses(run(drive[0] @ flip, scans)[1])
    # surfaces are numbered from the other end, so a piece that splits off may be another one
    # and earn its trust anew: millimetres
    assert np.abs(turned - poses(result[1])).max() < 0.003


def test_the_mirrored_drive_gives_the_mirrored_path(drive, result):
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    mount = mirror @ drive[0] @ mirror
    scans = [Scan(s.stamp_ns, s.ranges[::-1].copy(), -s.angles[::-1], s.times[::-1].copy(),
                  None, s.range_min, s.range_max) for s in drive[1]]
    mirrored = poses(run(mount, scans)[1]) * [1.0, -1.0, -1.0]
    # which neighbour is met first differs, and so do the last bits of what is dropped
    assert np.abs(mirrored - poses(result[1]))[:, :2].max() < 0.02


def test_scans_without_any_return_coast_and_say_so(drive):
    mount, scans, _ = drive
    blind = [replace(s, ranges=np.full(len(s), np.inf)) if i >= 375 else s
             for i, s in enumerate(scans)]
    live, final = run(mount, blind)
    assert len(final) == len(scans)
    assert not any(e.degenerate for e in live[150:200])
    assert all(e.degenerate for e in live[-60:])
    sigma = [np.sqrt(e.twist_covariance[0, 0]) for e in live[-100:]]
    assert np.all(np.diff(sigma[::10]) > 0.0)
    # it goes on as it went
    assert final[-1].twist[0] == pytest.approx(final[370].twist[0], abs=1.5)


@pytest.mark.parametrize('lost_knots', [5, 9])
@pytest.mark.parametrize('acceleration', [0.0, 0.5 * STEP, -0.5 * STEP])
def test_a_motion_taken_up_again_joins_the_path_without_a_step(drive, lost_knots, acceleration):
    mount, scans, _ = drive
    estimator = StriEstimator(mount)
    for scan in scans[:450]:
        estimator.add(scan)
    path = estimator._path
    times = np.arange(path.final_until - 0.5, path.step * path.h, 0.01)
    velocities = np.array([path.velocity(t) for t in times])
    end = path.pose(path.step * path.h)
    own = geometry.compose([0.0, 0.0, -end[2]], path.velocity(path.step * path.h))[:2]
    # lost: the path runs away from the motion by 1 m/s
    last = path.step + 4
    path.knots[last - lost_knots:last, :2] += np.outer(
        path.h * np.arange(1, lost_knots + 1), np.hypot(*own) ** -1.0 * velocities[-1, :2])
    away = np.array([path.velocity(t) for t in times]) - velocities
    assert np.hypot(*away[:, :2].T).max() > 0.9
    unit = own / np.hypot(*own)
    for _ in path.restart(np.array([*own, 0.0]), np.array([*(acceleration * unit), 0.0])):
        pass
    again = np.array([path.velocity(t) for t in times]) - velocities
    # two standard deviations of what two keyframes 0.2 s apart, each placed to 5 mm, tell
    assert np.hypot(*again[:, :2].T).max() < 2.0 * np.sqrt(2.0) * 0.005 / 0.2
    assert np.abs(again[:, 2]).max() < np.deg2rad(2.0)


def test_no_scan_waits_for_more_than_a_part_of_taking_up_a_motion(drive, monkeypatch):
    begun, whole = [], JointPath.restart

    def counted(path, twist, acceleration):
        for part in whole(path, twist, acceleration):
            begun.append(len(live))
            yield part

    monkeypatch.setattr(JointPath, 'restart', counted)
    estimator, live = StriEstimator(drive[0]), []
    for scan in drive[1]:
        live.append(estimator.add(scan))
        if len(live) >= 300 and estimator._advanced and not begun and not estimator._found:
            estimator._found = live[-1].twist, 0.0      # what a look would find here
    estimator.finish()
    assert len(begun) == 5 and len(set(begun)) == 5
    # it is the motion that the path had: nothing has changed but by its noise
    before, after = live[begun[0] - 1], live[begun[-1] + 1]
    seconds = (after.stamp_ns - before.stamp_ns) * 1e-9
    step = geometry.compose(geometry.inverse(before.pose), after.pose)
    assert np.abs(step - before.twist * seconds)[:2].max() < 0.02


def test_too_few_scans_give_nothing(drive):
    assert run(drive[0], drive[1][:3]) == ([], [])
    assert run(drive[0], []) == ([], [])


def test_empty_scans_alone_end_without_a_fault(drive):
    empty = [replace(s, ranges=np.full(len(s), np.nan)) for s in drive[1][:200]]
    _, final = run(drive[0], empty)
    assert all(np.isfinite(e.pose).all() for e in final)


def test_a_slow_scanner_with_late_stamps_and_a_pause_keeps_the_track(drive):
    # every 9th scan: 8.3 Hz, stamped up to 60 ms late, and nothing for a second
    rng = np.random.default_rng(5)
    slow = [s for s in drive[1][::9] if not 4e9 < s.stamp_ns - drive[1][0].stamp_ns < 5e9]
    late = np.maximum.accumulate([s.stamp_ns + rng.integers(60_000_000) for s in slow])
    _, final = run(drive[0], [replace(s, stamp_ns=int(t)) for s, t in zip(slow, late)])
    truth = drive[2].at([s.stamp_ns for s in slow])
    truth = geometry.compose(geometry.inverse(truth[0]), truth)
    path = poses(final)
    assert np.isfinite(path).all()
    # in the pause the speed may change by a metre per second; stamps are wrong by up to 60 ms
    # at up to 8 m/s
    assert np.hypot(*(path - truth)[-1, :2]) < 1.0 + 0.06 * 8.0


def test_scans_that_did_not_come_speak_neither_for_nor_against_the_motion(drive):
    origin = drive[1][0].stamp_ns
    estimator = StriEstimator(drive[0])
    agreement = []
    for scan in drive[1]:
        if not 3e9 < scan.stamp_ns - origin < 3.5e9:        # five knot intervals
            estimator.add(scan)
            if estimator._path is not None:
                agreement.append((scan.stamp_ns - origin, estimator._path.trust.agreement))
    before = next(a for t, a in reversed(agreement) if t <= 3e9)
    after = next(a for t, a in agreement if t >= 3.5e9)
    # the first scan after them makes the one interval final that has some of before
    assert before > 0.9 and after > 0.9
