# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Helpers of the tests that run real nodes over real DDS."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import count
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import Any

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from stri_mapping.bag_io import Bag, select_scanners
from stri_mapping.facade.cloud_files import read_ply
from stri_mapping.mapping import Mapper
from stri_mapping.node_process import SUPERVISOR_VARIABLE
from stri_mapping.vehicle import default_vehicle_file, load_vehicle

CAMPUS = Path(__file__).parent.parent / 'bags' / 'campus'
# Far beyond what anything here takes: reached only where something hangs.
TIMEOUT = 180.0
_numbers = count()


def environment() -> dict[str, str]:
    """Return a process environment with a ROS domain that no other test uses."""
    domain = 1 + (os.getpid() + 37 * next(_numbers)) % 100      # 101 and above clash with ports
    return {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'ROS_PYTHON_CHECK_FIELDS': '1',
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'PYTHONUNBUFFERED': '1'}


def cut_bag(source: Path, target: Path, seconds: float, twins: Mapping[str, str] | None = None,
            ) -> Path:
    """Copy the first seconds of a bag, bytes as they are; topics in `twins` again as another."""
    with Bag(source) as bag, Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as out:
        copies, start = {}, None
        for connection, log_ns, data in bag.raw_messages():
            start = log_ns if start is None else start
            if log_ns - start > seconds * 1e9:
                break
            twin = (twins or {}).get(connection.topic)
            for topic in [connection.topic, *([twin] if twin else [])]:
                if topic not in copies:
                    copies[topic] = out.add_connection(
                        topic, connection.msgtype, msgdef=connection.msgdef.data,
                        rihs01=connection.digest,
                        offered_qos_profiles=connection.ext.offered_qos_profiles)
                out.write(copies[topic], log_ns, data)
    return target


def map_offline(bag_path: Path, folder: Path) -> Path:
    """Map a bag as `stri-mapping map` does, without its report."""
    folder.mkdir()
    with Bag(bag_path) as bag:
        mapper = Mapper(select_scanners(bag, load_vehicle(default_vehicle_file())), folder)
        for scanner, scan in bag.scans(mapper.vehicle.scanners):
            mapper.add(scanner, scan)
        mapper.finish()
    return folder


@contextmanager
def command(*arguments: object, env: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Start a stri-mapping command; it and its nodes are gone when the context is left."""
    process = subprocess.Popen(
        [sys.executable, '-m', 'stri_mapping.cli', *map(str, arguments)], env=env,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process
    finally:
        for pid in [process.pid, *node_pids(process.pid)]:
            try:
                os.kill(pid, 9)
            except ProcessLookupError:
                pass
        if not process.stdout.closed:
            process.communicate()


@contextmanager
def node(module: str, parameters: dict[str, object], env: dict[str, str], *extra: str,
         ) -> Iterator[subprocess.Popen[str]]:
    """Start one node on its own, with further arguments for ROS."""
    given = [part for name, value in parameters.items() for part in ('-p', f'{name}:={value}')]
    process = subprocess.Popen(
        [sys.executable, '-m', f'stri_mapping.nodes.{module}', '--ros-args', *given, *extra],
        env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process
    finally:
        process.kill()
        if not process.stdout.closed:
            process.communicate()


@contextmanager
def listener() -> Iterator[tuple[Any, Any, dict[str, str]]]:
    """Give a node of this process, its executor, and the environment of its ROS domain."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    env = environment()
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(env['ROS_DOMAIN_ID']))
    own = rclpy.create_node('listener', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(own)
    try:
        yield own, executor, env
    finally:
        executor.shutdown()
        own.destroy_node()
        context.try_shutdown()


def lossless() -> Any:
    """Return the quality of service with which nothing gets lost."""
    from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
    return QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_ALL)


def latched() -> Any:
    """Return the quality of service that also gives what was published before."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
    return QoSProfile(history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def spin_until(executor: Any, condition: Callable[[], object], what: str) -> None:
    """Run callbacks until a condition holds."""
    wait_until(lambda: executor.spin_once(timeout_sec=0.05) or condition(), what)


def node_pids(supervisor: int) -> list[int]:
    """Return the live processes that a supervisor has started, however they are parented now."""
    mark = f'{SUPERVISOR_VARIABLE}={supervisor}'.encode()
    found = []
    for entry in Path('/proc').iterdir():
        try:
            if entry.name.isdigit() and mark in (entry / 'environ').read_bytes().split(b'\0'):
                found.append(int(entry.name))
        except OSError:                 # ended meanwhile, or not ours
            continue
    return found


def node_pid(supervisor: int, module: str) -> int:
    """Return the process of one node of a supervisor."""
    return next(pid for pid in node_pids(supervisor)
                if f'stri_mapping.nodes.{module}'.encode()
                in Path(f'/proc/{pid}/cmdline').read_bytes())


def wait_until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition; fail, naming it, only where something hangs."""
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end, f'never came: {what}'
        time.sleep(0.02)


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """Give a disk of some size, such as 2m; skip the test where none can be mounted."""
    disk = folder / 'disk'
    disk.mkdir()
    done = subprocess.run(['mount', '-t', 'tmpfs', '-o', f'size={size}', 'tmpfs', disk],
                          check=False, capture_output=True)
    if done.returncode:
        pytest.skip('only root may mount a small disk')
    try:
        yield disk
    finally:
        subprocess.run(['umount', '--lazy', disk], check=True)


def point_count(folder: Path) -> int:
    """Return how many points a results folder holds."""
    return sum(len(rows) for rows in read_ply(folder / 'facade.ply'))


def line_count(path: Path) -> int:
    """Return the number of lines of a file that may not be there yet."""
    return path.read_bytes().count(b'\n') if path.is_file() else 0


needs_ros = pytest.mark.skipif(
    find_spec('rclpy') is None,
    reason='needs ROS 2: pip install stri_mapping[ros], or source an installation')


def shown(arguments: Sequence[object], env: dict[str, str]) -> tuple[int, str]:
    """Run a command to its end; return exit code and output."""
    with command(*arguments, env=env) as process:
        output, _ = process.communicate(timeout=TIMEOUT)
    return process.returncode, output
