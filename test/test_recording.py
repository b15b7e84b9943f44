# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings: readable by every reader, whole after a crash, a cut anywhere, a full disk."""

from __future__ import annotations

from itertools import groupby
import os
from pathlib import Path

from hypothesis import event, given, settings
from hypothesis import strategies as st
import live
import pytest
import yaml

from stri_mapping import cli
from stri_mapping.bag_io import Bag
from stri_mapping.errors import BagError
from stri_mapping.recording.bag import DiskFullError, Recording
from stri_mapping.recording.definitions import Definitions
from stri_mapping.recording.mcap_file import McapFile, Topic
from stri_mapping.recording.repair import repair

EVER = {'sec': 9223372036, 'nsec': 854775807}
HASH = 'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18'
STRING = Topic('/text', 'std_msgs/msg/String', b'string data\n', HASH, yaml.safe_dump([{
    'history': 'unknown', 'depth': 0, 'reliability': 'reliable', 'durability': 'volatile',
    'deadline': EVER, 'lifespan': EVER, 'liveliness': 'automatic',
    'liveliness_lease_duration': EVER, 'avoid_ros_namespace_conventions': False}]))
PERIOD_NS = 10_000_000
START_NS = 1_767_225_600 * 10**9


def payload(number: int, size: int = 60) -> bytes:
    """Return a serialised std_msgs/String; no two are alike, nor compress well."""
    text = f'{number:08d}' + os.urandom(size // 2).hex()
    return b'\0\1\0\0' + (len(text) + 1).to_bytes(4, 'little') + text.encode() + b'\0'


def record(folder: Path, count: int, flush_every: int = 10, **splits: int) -> list[bytes]:
    """Record some messages; return them."""
    recording = Recording(folder, **splits)
    sent = [payload(number) for number in range(count)]
    for number, data in enumerate(sent):
        stamp = START_NS + number * PERIOD_NS
        recording.write(STRING, stamp, stamp, data)
        if number % flush_every == flush_every - 1:
            recording.flush()
    recording.close()
    return sent


def read(path: Path) -> list[bytes]:
    with Bag(path) as bag:
        return [bytes(data) for _, _, data in bag.raw_messages()]


@pytest.mark.parametrize('splits, files', [
    ({}, 1), ({'split_bytes': 10_000}, 3), ({'split_ns': 100 * PERIOD_NS}, 5)])
def test_a_bag_is_read_back_byte_for_byte_however_it_is_split(splits, files, tmp_path):
    sent = record(tmp_path / 'bag', 500, **splits)
    assert read(tmp_path / 'bag') == sent
    parts = sorted((tmp_path / 'bag').glob('*.mcap'))
    assert len(parts) >= files
    if 'split_ns' in splits:
        assert len(parts) == files


def test_metadata_is_what_rosbag2_writes(tmp_path):
    record(tmp_path / 'bag', 300, split_ns=100 * PERIOD_NS)
    text = (tmp_path / 'bag/metadata.yaml').read_text(encoding='utf-8')
    content = yaml.safe_load(text)['rosbag2_bagfile_information']
    assert list(content) == [
        'version', 'storage_identifier', 'duration', 'starting_time', 'message_count',
        'topics_with_message_count', 'compression_format', 'compression_mode',
        'relative_file_paths', 'files', 'custom_data', 'ros_distro']
    assert (content['version'], content['storage_identifier']) == (9, 'mcap')
    assert content['relative_file_paths'] == ['bag_0.mcap', 'bag_1.mcap', 'bag_2.mcap']
    assert content['duration']['nanoseconds'] == 299 * PERIOD_NS
    assert [file['message_count'] for file in content['files']] == [100, 100, 100]
    topic, = content['topics_with_message_count']
    assert topic['message_count'] == content['message_count'] == 300
    assert topic['topic_metadata']['offered_qos_profiles'] == yaml.safe_load(STRING.qos)


def test_another_reader_finds_index_checksums_and_metadata_in_order(tmp_path):
    reader = pytest.importorskip('mcap.reader', reason='pip install mcap zstandard')
    record(tmp_path / 'bag', 200)
    with (tmp_path / 'bag/bag_0.mcap').open('rb') as file:
        whole = reader.make_reader(file, validate_crcs=True)
        summary = whole.get_summary()
        assert summary.statistics.message_count == 200
        assert len(summary.chunk_indexes) == 20
        late = list(whole.iter_messages(starting_at=START_NS + 150 * PERIOD_NS))
        assert len(late) == 50                          # found by the index
        assert {schema.encoding for schema, _, _ in late} == {'ros2msg'}
        assert [m.name for m in whole.iter_metadata()] == ['rosbag2']
        assert whole.get_header().profile == 'ros2'


class Whole:
    """A recording of 300 messages: its one file, and what it holds."""

    def __init__(self, folder: Path) -> None:
        self.sent = record(folder, 300)
        self.content = (folder / 'bag_0.mcap').read_bytes()


@pytest.fixture(scope='module')
def whole(tmp_path_factory) -> Whole:
    return Whole(tmp_path_factory.mktemp('whole') / 'bag')


@settings(max_examples=40, deadline=None)
@given(share=st.floats(0.0, 1.0))
def test_cut_anywhere_every_whole_chunk_comes_back(share, whole, tmp_path_factory):
    content, sent = whole.content, whole.sent
    folder = tmp_path_factory.mktemp('cut') / 'bag'
    folder.mkdir()
    cut = max(int(share * len(content)), 8)
    (folder / 'bag_0.mcap').write_bytes(content[:cut])
    done = repair(folder)
    found = read(folder) if done.messages else []
    same = found == sent[:done.messages]
    assert same                                         # not the lists: telling them apart is slow
    # chunks of 10 messages take the same room each, up to the index at the end
    bytes_a_message = content.index(b'rosbag2') / len(sent)
    assert done.messages >= min(cut / bytes_a_message, len(sent)) - 25
    assert repair(folder).mended == []                  # and then it is whole


@settings(max_examples=30, deadline=None)
@given(position=st.floats(0.1, 0.9), value=st.integers(0, 255))
def test_a_wrong_byte_costs_little_and_invents_nothing(position, value, whole, tmp_path_factory):
    content, sent = whole.content, whole.sent
    folder = tmp_path_factory.mktemp('wrong') / 'bag'
    folder.mkdir()
    at = int(position * len(content))
    (folder / 'bag_0.mcap').write_bytes(content[:at] + bytes([value]) + content[at + 1:])
    repair(folder)
    found = read(folder)
    known = set(sent)
    lost = len(sent) - sum(data in known for data in found)
    event(f'lost {lost}')
    assert sum(data not in known for data in found) <= 10       # the chunk with the wrong byte


def test_repair_of_a_split_bag_keeps_what_is_whole_and_the_damaged_file(tmp_path):
    folder = tmp_path / 'bag'
    sent = record(folder, 300, split_ns=100 * PERIOD_NS)
    before = (folder / 'bag_0.mcap').read_bytes()
    (folder / 'metadata.yaml').unlink()
    last = folder / 'bag_2.mcap'
    last.write_bytes(last.read_bytes()[:-500])
    with pytest.raises(BagError, match='stri-mapping repair'), Bag(folder):
        pass
    done = repair(folder)
    assert done.mended == ['bag_2.mcap']
    assert (folder / 'bag_2.mcap.damaged').is_file()
    assert (folder / 'bag_0.mcap').read_bytes() == before
    assert read(folder) == sent


def test_the_command_says_what_it_did(tmp_path, capsys):
    record(tmp_path / 'bag', 50)
    file = tmp_path / 'bag/bag_0.mcap'
    file.write_bytes(file.read_bytes()[:-100])
    assert cli.main(['repair', str(tmp_path / 'bag')]) == 0
    said = capsys.readouterr().out
    assert '50 messages' in said
    assert 'bag_0.mcap.damaged' in said
    assert cli.main(['repair', str(tmp_path / 'nowhere')]) == 1
    (tmp_path / 'empty').mkdir()
    assert cli.main(['repair', str(tmp_path / 'empty')]) == 1
    (tmp_path / 'text.mcap').write_text('no bag', encoding='utf-8')
    assert cli.main(['repair', str(tmp_path / 'text.mcap')]) == 1
    assert capsys.readouterr().err.count('\n') == 3


@pytest.fixture
def small_disk(tmp_path):
    with live.small_disk(tmp_path, '2m') as disk:
        yield disk


def test_a_full_disk_ends_the_recording_and_the_bag_is_whole(small_disk):
    recording = Recording(small_disk / 'bag')
    sent = []
    with pytest.raises(DiskFullError, match='recording stopped'):
        for number in range(10_000):
            sent.append(payload(number, 2000))
            recording.write(STRING, START_NS + number, START_NS + number, sent[-1])
            if number % 20 == 19:
                recording.flush()
    recording.close()
    found = read(small_disk / 'bag')
    assert found == sent[:len(found)]
    assert len(found) > 500                             # 2 MB hold some 900
    assert repair(small_disk / 'bag').mended == []


def test_without_one_byte_of_room_left_the_last_chunks_make_it(small_disk):
    file = McapFile(small_disk / 'a.mcap')
    sent = []
    with pytest.raises(OSError):
        for number in range(10_000):
            sent.append(payload(number, 2000))
            file.write(STRING, START_NS + number, START_NS + number, sent[-1])
            if number % 20 == 19:
                file.flush()
    file.finish('{}')
    found = read(small_disk / 'a.mcap')
    assert found == sent[:len(found)]
    assert len(found) > 500


def test_what_exists_is_not_written_over(tmp_path):
    record(tmp_path / 'bag', 1)
    with pytest.raises(BagError, match='exists already'):
        Recording(tmp_path / 'bag')
    with pytest.raises(BagError, match='cannot be made'):
        Recording(Path('/proc/none/bag'))


def test_definitions_come_from_ros_and_from_installed_packages(tmp_path, monkeypatch):
    share = tmp_path / 'share/my_msgs/msg'
    share.mkdir(parents=True)
    (share / 'Pair.msg').write_text('Half a\nHalf[] b\nstd_msgs/Header header\n', encoding='utf-8')
    (share / 'Half.msg').write_text('float32 x\n', encoding='utf-8')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    definitions = Definitions()
    scan = definitions.topic('/scan', 'sensor_msgs/msg/LaserScan', '[]')
    # as every ROS 2 Jazzy has it
    assert scan.digest == ('RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd'
                           '828')
    pair = definitions.topic('/pair', 'my_msgs/msg/Pair', '[]')
    assert b'MSG: my_msgs/Half' in pair.definition
    assert definitions.topic('/none', 'my_msgs/msg/None', '[]') is None


def test_names_of_a_split_bag_sort_by_their_number(tmp_path):
    sent = record(tmp_path / 'bag', 240, split_ns=20 * PERIOD_NS)
    (tmp_path / 'bag/metadata.yaml').unlink()
    assert repair(tmp_path / 'bag').mended == []
    with Bag(tmp_path / 'bag') as bag:
        stamps = [log_ns for _, log_ns, _ in bag.raw_messages()]
    assert len(stamps) == len(sent)
    content = yaml.safe_load((tmp_path / 'bag/metadata.yaml').read_text(encoding='utf-8'))
    names = content['rosbag2_bagfile_information']['relative_file_paths']
    assert names == [f'bag_{number}.mcap' for number in range(12)]
    assert [key for key, _ in groupby(stamps)] == sorted(set(stamps))
