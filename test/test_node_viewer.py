# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The viewer: every topic with its definition at a WebSocket, bytes as they are."""

from __future__ import annotations

import asyncio
import json
import struct

import live
import pytest

from stri_mapping.bag_io import Bag

websockets = pytest.importorskip('websockets', reason='pip install websockets')
pytest.importorskip('foxglove', reason='pip install stri_mapping[viewer]')
pytestmark = [live.needs_ros, pytest.mark.skipif(
    not live.CAMPUS.is_dir(), reason=f'{live.CAMPUS} is not there')]

TOPIC = '/horizontal/scan'


async def viewed(url: str, count: int) -> tuple[dict[str, dict], dict[str, list[bytes]]]:
    """Return the channels, and their messages until there are so many scans."""
    channels: dict[int, dict] = {}
    messages: dict[str, list[bytes]] = {}
    async with websockets.connect(url, subprotocols=['foxglove.sdk.v1']) as socket:
        while len(messages.get(TOPIC, [])) < count:
            data = await asyncio.wait_for(socket.recv(), live.TIMEOUT)
            if isinstance(data, str):
                told = json.loads(data)
                for channel in told.get('channels', []):
                    channels[channel['id']] = channel
                    await socket.send(json.dumps({'op': 'subscribe', 'subscriptions': [
                        {'id': channel['id'], 'channelId': channel['id']}]}))
            else:
                _, number, _ = struct.unpack_from('<BIQ', data)
                messages.setdefault(channels[number]['topic'], []).append(data[13:])
    return {channel['topic']: channel for channel in channels.values()}, messages


def test_topics_come_raw_with_their_definitions_and_latched_ones_late(tmp_path):
    with Bag(live.CAMPUS) as bag:
        sent = {bytes(data) for _, _, data in bag.raw_messages([TOPIC])}
    env = live.environment()
    with live.node('viewer', {'port': 0}, env) as viewer:
        line = next(line for line in viewer.stdout if 'open ws' in line)
        url = line.split('open ')[1].split()[0]
        assert url.startswith('ws://127.0.0.1:')
        player = {'bag': live.CAMPUS, 'subscribers': TOPIC}
        with live.node('bag_player', player, env):
            channels, messages = asyncio.run(viewed(url, 100))
        viewer.send_signal(2)
        output, _ = viewer.communicate(timeout=live.TIMEOUT)
    assert viewer.returncode == 0, output
    assert 'Traceback' not in output
    assert (channels[TOPIC]['encoding'], channels[TOPIC]['schemaEncoding']) == ('cdr', 'ros2msg')
    assert 'float32[] ranges' in channels[TOPIC]['schema']
    assert set(messages[TOPIC]) <= sent
    if live.find_spec('tf2_msgs'):
        assert len(messages['/tf_static']) >= 1          # published before anyone looked


def test_a_port_that_is_taken_is_said_in_one_line():
    env = live.environment()
    with live.node('viewer', {'port': 0}, env) as viewer:
        line = next(line for line in viewer.stdout if 'open ws' in line)
        port = int(line.split('127.0.0.1:')[1].split()[0])
        with live.node('viewer', {'port': port}, env) as second:
            output, _ = second.communicate(timeout=live.TIMEOUT)
    assert second.returncode == 2, output
    assert 'cannot be served' in output
    assert 'Traceback' not in output
