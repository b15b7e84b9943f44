# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Which nodes make the live graph, what they are told, and in which order they end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stri_mapping.node_process import NodeSpec
from stri_mapping.vehicle import Scanner, Vehicle

Stages = list[list[NodeSpec]]
# What a recording need not hold: it can be made again from the scans.
DERIVED = ('facade/', 'stri/')
# Seconds after which a recording begins a new file: what must be remembered of one is bounded.
SPLIT = 600.0
# Seconds the virtual vehicle waits for its drivers, which wait for nodes that may compile.
PATIENCE = 600.0


@dataclass(frozen=True)
class Products:
    """
    Where the graph's results go.

    Attributes
    ----------
    folder
        Results folder; the description of the vehicle is in it as vehicle.yaml.
    recording
        Bag to record; None for none.
    view
        Whether to serve all topics to a viewer.

    """

    folder: Path
    recording: Path | None = None
    view: bool = False

    @property
    def vehicle_file(self) -> str:
        """Path of the vehicle's description."""
        return str((self.folder / 'vehicle.yaml').resolve())


def bag_graph(vehicle: Vehicle, products: Products, bag: Path, rate: float,
              topics: Sequence[str]) -> Stages:
    """Return the graph that maps a bag: player, estimator, aligner."""
    scans = [s.topic for s in vehicle.scanners]
    player = NodeSpec('bag_player', {
        'bag': str(bag.resolve()), 'rate': rate, 'follow': 'odom', 'topics': ' '.join(topics),
        'subscribers': ' '.join(scans * (1 if products.recording is None else 2)),
        'position': str((products.folder / 'position').resolve())}, source=True)
    return [[player], *_processing(vehicle, products, tf_static_wait=0.0)]


def hardware_graph(vehicle: Vehicle, products: Products) -> Stages:
    """Return the graph on the vehicle: drivers, estimator, aligner."""
    return [[_driver(s, s.port) for s in vehicle.scanners],
            *_processing(vehicle, products, tf_static_wait=3.0)]


def virtual_graph(vehicle: Vehicle, products: Products, ports: Path,
                  options: dict[str, Any]) -> Stages:
    """Return the graph of a virtual drive: its scanners' bytes come over pseudo-terminals."""
    virtual = NodeSpec('virtual_vehicle', {
        'vehicle_file': products.vehicle_file, 'ports': str(ports), 'patience': PATIENCE,
        **options}, source=True)
    drivers = [_driver(s, {**s.port, 'serial_port': str(ports / s.name)})
               for s in vehicle.scanners]
    return [[virtual], drivers, *_processing(vehicle, products, tf_static_wait=0.0)]


def _driver(scanner: Scanner, port: Any) -> NodeSpec:
    remappings = {} if scanner.topic.lstrip('/') == f'{scanner.name}/scan' else {
        'scan': '/' + scanner.topic.lstrip('/')}
    # each driver configures and activates itself: a supervisor that asked it by service would
    # have to find it first, which takes as long as a restart may take altogether
    return NodeSpec('sick_lms_driver', {**port, 'frame_id': scanner.frame, 'self_start': True},
                    namespace=scanner.name, remappings=remappings,
                    vital=scanner.role == 'horizontal', resumes=False, waits=True,
                    nice=-10)


def _processing(vehicle: Vehicle, products: Products, tf_static_wait: float) -> Stages:
    """Return what follows the scans, in the order of the data."""
    common = {'vehicle_file': products.vehicle_file, 'output': str(products.folder.resolve()),
              'tf_static_wait': tf_static_wait}
    # no use_sim_time: the nodes take all times from the scans, and hundreds of messages a second
    # on /clock would cost each of them a fifth of a core
    # what steers by the odometry cannot wait; facades can, and bags gather in their readers
    stages = [[NodeSpec('stri_estimator', common, nice=-10)]]
    if vehicle.verticals:
        stages.append([NodeSpec('facade_aligner', common, nice=5)])
    if products.recording is not None:
        stages.append([NodeSpec('bag_recorder', {
            'path': str(products.recording.resolve()), 'exclude': ' '.join(DERIVED),
            'split_duration': SPLIT},
            vital=False, nice=5)])
    if products.view:
        stages.append([NodeSpec('viewer', vital=False, resumes=False, nice=5)])
    return stages
