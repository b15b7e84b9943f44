# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""An aligner in the place of one that was killed: every point once, and none lost on disk."""

from __future__ import annotations

from functools import cache
import os
from pathlib import Path
import random
import subprocess
import sys

from hypothesis import given, settings
from hypothesis import strategies as st
import live
import numpy as np
import pytest
from test_facade_stabiliser import (
    ANGLES,
    ROAD,
    scan_at,
    SPEED,
    swaying,
    T0,
    TIMES,
    TURN_NS,
    VERTICALS,
    WALL,
)

from stri_mapping.facade.cloud_files import count_points, last_times, read_ply
from stri_mapping.facade.journal import (
    COUNTS,
    Journal,
    JOURNAL_NAMES,
    KEPT_NS,
    POSES,
    SCAN,
    whole_records,
)
from stri_mapping.facade.push_broom import FacadeAligner
from stri_mapping.facade.takeover import Takeover
from stri_mapping.facade.writer import FacadeWriter
from stri_mapping.scan import Scan

# Turns of the mirrors that the path is late, and from one message of it to the next.
LATE, MESSAGE = 135, 8
CAME = 'came'


@cache
def message_of(ring: int, turn: int) -> bytes:
    """Return the scan of one scanner in one turn of the mirrors: its stamp and ranges."""
    stamp = T0 + turn * TURN_NS + ring * 4_000_000
    scan = scan_at(VERTICALS[ring], stamp, swaying, [ROAD, WALL],
                   np.random.default_rng([ring, turn]))
    return np.int64(stamp).tobytes() + scan.ranges.tobytes()


def scan_of(message: bytes) -> Scan:
    return Scan(int(np.frombuffer(message, np.int64, 1)[0]),
                np.frombuffer(message, np.float64, offset=8), ANGLES, TIMES, range_max=80.0)


class Drive:
    """What the aligner's node does with its input, as far as files are concerned."""

    def __init__(self, folder: Path, resume: bool) -> None:
        self.folder = folder
        self.journal = Journal(folder, resume)
        self.aligner = FacadeAligner(VERTICALS)
        self.writer = FacadeWriter(folder, [s.name for s in VERTICALS], append=resume)
        self.takeover = Takeover(self.aligner, self.journal.read_back(), folder / 'facade.ply',
                                 scan_of)

    def go(self, first: int, last: int) -> None:
        """Take the scans of some turns, and the path, which comes whole again."""
        known = 0
        for turn in range(first, last):
            for ring in range(len(VERTICALS)):
                message = message_of(ring, turn)
                scan = scan_of(message)
                with (self.folder / CAME).open('ab', buffering=0) as came:
                    came.write(np.array([ring, scan.stamp_ns]).tobytes())
                self.journal.add_scan(ring, scan.stamp_ns, message)
                self.aligner.add_scan(ring, scan)
            if turn % MESSAGE == 0 and turn > LATE:
                self.add_path(known, turn - LATE)
                known = turn - LATE

    def add_path(self, begin: int, end: int) -> None:
        stamps = T0 + np.arange(begin, end) * TURN_NS
        poses = np.column_stack([SPEED * (stamps - T0) * 1e-9, 0 * stamps, 0 * stamps])
        if self.takeover.newest is None or stamps[-1] > self.takeover.newest[0]:
            self.journal.add_poses(stamps, poses)
            self.aligner.add_poses(stamps, poses)
        self.take()

    def take(self) -> None:
        points = self.takeover.new(self.aligner.take_points())
        stamps, poses = self.aligner.take_poses()
        self.writer.write(points, stamps, poses)
        self.journal.add_counts(self.aligner.counts)
        if len(stamps):
            self.journal.forget(int(stamps[-1]))

    def finish(self, turns: int) -> None:
        self.add_path(0, turns + 2)
        self.aligner.finish()
        self.take()
        self.writer.close()
        self.journal.close()


def check(drive: Drive, turns: int) -> None:
    """Compare the cloud with the scans that came: every ray that hit something, once."""
    rings, stamps = np.frombuffer((drive.folder / CAME).read_bytes(), np.int64).reshape(-1, 2).T
    rows = np.concatenate(list(read_ply(drive.folder / 'facade.ply')))
    for ring in range(len(VERTICALS)):
        scans = [scan_of(message_of(ring, turn)) for turn in (
            stamps[rings == ring] - T0) // TURN_NS]
        expected = np.concatenate([(s.stamp_ns + np.rint(s.times[s.valid] * 1e9).astype(int))
                                   * 1e-9 for s in scans])
        np.testing.assert_array_equal(rows['time'][rows['ring'] == ring], expected)
    counts = drive.aligner.counts
    assert counts.points == len(rows)
    assert counts.points + counts.no_return + counts.outside == len(stamps) * len(ANGLES)
    assert counts.scans == len(stamps)
    poses = (drive.folder / 'trajectory_stabilised.tum').read_text().splitlines()
    assert [line.split()[0] for line in poses] == [
        f'{t // 10**9}.{t % 10**9:09d}' for t in T0 + np.arange(turns + 2) * TURN_NS]
    assert not any((drive.folder / name).exists() for name in JOURNAL_NAMES)


@given(st.integers(1, 620), st.integers(0, 200), st.integers(0, 60))
@settings(max_examples=10, deadline=None)
def test_no_point_is_lost_or_doubled_wherever_a_drive_breaks_off(
        tmp_path_factory: pytest.TempPathFactory, kill: int, down: int, torn: int) -> None:
    folder, turns = tmp_path_factory.mktemp('drive'), 840
    Drive(folder, resume=False).go(0, kill)              # and no more is heard of it
    with (folder / JOURNAL_NAMES[0]).open('ab') as journal:     # it was about to add a record
        journal.write(bytes([17, 0, 0, 0, *range(torn)]))
    second = Drive(folder, resume=True)
    second.go(kill + down, turns)
    second.finish(turns)
    check(second, turns)


def feed(folder: str, resume: str, first: str) -> None:
    """Be the process that is killed."""
    Drive(Path(folder), resume == 'True').go(int(first), 10**6)


def last_that_came(folder: Path) -> int:
    """Return the stamp of the last scan, having struck out one that the journal lacks."""
    came = folder / CAME
    os.truncate(came, came.stat().st_size // 16 * 16)
    records = [r for name in reversed(JOURNAL_NAMES) if (folder / name).is_file()
               for r in whole_records((folder / name).read_bytes())[0] if r.kind == SCAN]
    kept = records[-1].ring, scan_of(records[-1].content).stamp_ns
    lines = np.frombuffer(came.read_bytes(), np.int64).reshape(-1, 2).tolist()
    if tuple(lines[-1]) != kept:
        assert tuple(lines[-2]) == kept
        os.truncate(came, 16 * (len(lines) - 1))
    return kept[1]


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_no_point_is_lost_or_doubled_by_kill_9(tmp_path: Path, seed: int) -> None:
    chance, first, came = random.Random(seed), 0, tmp_path / CAME
    for life in range(3):
        enough = (came.stat().st_size if life else 0) + 16 * chance.randrange(10, 2500)
        process = subprocess.Popen(
            [sys.executable, '-c', 'import sys, test_facade_takeover as t; t.feed(*sys.argv[1:])',
             tmp_path, str(life > 0), str(first)], cwd=Path(__file__).parent)
        try:
            live.wait_until(lambda n=enough, p=process: p.poll() is not None or (
                came.is_file() and came.stat().st_size >= n), 'scans')
            assert process.poll() is None
        finally:
            process.kill()
            process.wait()
        first = (last_that_came(tmp_path) - T0) // TURN_NS + chance.randrange(1, 100)
    last = Drive(tmp_path, resume=True)
    last.go(first, first + 200)
    last.finish(first + 200)
    check(last, first + 200)


def test_a_cloud_goes_on_as_it_would_have_without_the_kill(tmp_path: Path) -> None:
    for folder, kill in ((tmp_path / 'whole', 0), (tmp_path / 'broken', 700)):
        folder.mkdir()
        if kill:
            Drive(folder, resume=False).go(0, kill)
        drive = Drive(folder, resume=kill > 0)
        drive.go(kill, 1000)
        drive.finish(1000)
    whole, broken = (np.concatenate(list(read_ply(tmp_path / name / 'facade.ply')))
                     for name in ('whole', 'broken'))
    order = [np.lexsort((rows['time'], rows['ring'])) for rows in (whole, broken)]
    off = np.stack([whole[axis][order[0]] - broken[axis][order[1]] for axis in 'xyz'])
    # slow parameters and the walls of more than some seconds ago are not known any more
    assert np.abs(off).max() < 0.02
    assert np.sqrt(np.mean(off**2)) < 0.002


def test_a_journal_is_bounded_and_ends_with_its_last_whole_record(tmp_path: Path) -> None:
    drive = Drive(tmp_path, resume=False)
    drive.go(0, 2500)
    kept = drive.journal.read_back()
    stamps = [scan_of(r.content).stamp_ns for r in kept if r.kind == SCAN]
    done = min(last_times(tmp_path / 'facade.ply', 0.0).values())
    assert done - 1e-9 * stamps[0] > 1e-9 * KEPT_NS
    assert stamps[-1] - stamps[0] < 2 * KEPT_NS + 8e9
    assert {r.kind for r in kept} == {SCAN, POSES, COUNTS}
    newer = tmp_path / JOURNAL_NAMES[0]
    whole, size = newer.read_bytes(), newer.stat().st_size
    assert whole_records(whole)[1] == size
    for cut in (1, 9, 60):
        found, end = whole_records(whole[:-cut])
        assert found == whole_records(whole)[0][:-1]
        assert end < size - cut
    damaged = bytearray(whole)
    damaged[-1] ^= 1
    assert whole_records(bytes(damaged))[0] == found
    assert Journal(tmp_path).read_back() == []           # a new drive


def test_a_full_disk_ends_the_journal_with_one_warning(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with live.small_disk(tmp_path, '300k') as disk:
        journal = Journal(disk)
        for turn in range(400):
            journal.add_scan(0, T0 + turn * TURN_NS, message_of(0, turn))
        warning, = caplog.messages
        assert 'facade_journal: cannot be written: No space left on device' in warning
        assert not list(disk.iterdir())
        assert journal.read_back() == []
        journal.close()


def test_nothing_is_kept_without_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    journal = Journal(None, resume=True)
    journal.add_scan(0, T0, b'scan')
    journal.close()
    assert not list(tmp_path.iterdir())
    assert count_points(tmp_path / 'facade.ply') == 0
