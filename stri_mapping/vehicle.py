# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The vehicle: its scanners, their roles, mounts and ports, read from vehicle.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import logging
import os
from pathlib import Path
import re
import sys
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
import yaml

from stri_mapping import geometry
from stri_mapping.errors import VehicleError

Array = NDArray[np.float64]
Role = Literal['horizontal', 'vertical']
ROLES: tuple[Role, ...] = ('horizontal', 'vertical')
PULLS = -3e-5, 9e-5     # 1/m, from what may be learnt of none to twice the widest beam's
logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Scanner:
    """
    One line scanner on the vehicle.

    Attributes
    ----------
    name
        Names the topic ``<name>/scan`` and the default frame ``<name>_laser``.
    role
        'horizontal' gives the motion, 'vertical' the facades.
    T_base_laser
        (4, 4) pose of the laser frame in base_link, metres.
    frame
        Frame id of its scans.
    topic
        Topic of its scans.
    port
        Settings of the serial port, passed on to the driver as they are.
    footprint_pull
        By which its ranges fall short on slanted surfaces, 1/m (see `stri.range_error`); None
        where an earlier drive has not told it.

    """

    name: str
    role: Role
    T_base_laser: Array
    frame: str
    topic: str
    port: Mapping[str, Any] = field(default_factory=dict)
    footprint_pull: float | None = None

    @property
    def planar_mount(self) -> Array:
        """
        Mount (x, y, yaw) in base_link, its scan plane seen from above.

        Raises
        ------
        VehicleError
            If the scan plane is tilted by more than 30 degrees: then it is not horizontal.

        """
        axis = self.T_base_laser[:3, 2]
        if abs(axis[2]) < np.cos(np.deg2rad(30.0)):
            raise VehicleError(f'scanner "{self.name}": role is horizontal, but its scan plane is '
                               f'tilted by {np.rad2deg(np.arccos(abs(axis[2]))):.0f} degrees')
        return geometry.planar_pose(self.T_base_laser)


@dataclass(frozen=True, eq=False)
class Vehicle:
    """The scanners of one vehicle; exactly one is horizontal, names, frames, topics differ."""

    scanners: tuple[Scanner, ...]

    def __post_init__(self) -> None:
        """Check roles and that nothing is named twice."""
        count = sum(s.role == 'horizontal' for s in self.scanners)
        if count != 1:
            raise VehicleError(f'{count} scanners with role horizontal, want exactly one')
        for what in ('name', 'frame', 'topic'):
            values = [getattr(s, what) for s in self.scanners]
            twice = sorted({v for v in values if values.count(v) > 1})
            if twice:
                raise VehicleError(f'{what} "{twice[0]}" is used by more than one scanner')

    @property
    def horizontal(self) -> Scanner:
        """The scanner that gives the motion."""
        return next(s for s in self.scanners if s.role == 'horizontal')

    @property
    def verticals(self) -> tuple[Scanner, ...]:
        """The scanners that give the facades, in the file's order (their ring numbers)."""
        return tuple(s for s in self.scanners if s.role == 'vertical')


def remounted(scanner: Scanner, frame: str, T_base_laser: Array) -> Scanner:
    """
    Return a scanner with the mount that /tf_static has for the frame of its scans.

    A difference of more than 1 cm or 0.5 degrees from the mount it had is said.
    """
    if np.all(np.isfinite(scanner.T_base_laser)):
        difference = np.linalg.inv(scanner.T_base_laser) @ T_base_laser
        shift = float(np.linalg.norm(difference[:3, 3]))
        turn = float(np.arccos(np.clip((np.trace(difference[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))
        if shift > 0.01 or turn > np.deg2rad(0.5):
            logger.warning('%s: /tf_static puts frame "%s" %.3f m and %.1f deg from where the '
                           'vehicle file has "%s"; /tf_static is used', scanner.topic, frame,
                           shift, np.rad2deg(turn), scanner.name)
    return replace(scanner, frame=frame, T_base_laser=T_base_laser)


def write_vehicle(path: Path, vehicle: Vehicle) -> None:
    """Write a vehicle description that `load_vehicle` reads back as the same vehicle."""
    entries = [{
        'name': s.name, 'role': s.role, 'frame': s.frame or f'{s.name}_laser', 'topic': s.topic,
        'mount': {'xyz': s.T_base_laser[:3, 3].tolist(),
                  'rpy': geometry.rpy_from_rotation(s.T_base_laser[:3, :3]).tolist()},
        'port': dict(s.port),
        **({} if s.footprint_pull is None else {'footprint_pull': s.footprint_pull})}
        for s in vehicle.scanners]
    path.write_text(yaml.safe_dump({'scanners': entries}, sort_keys=False), encoding='utf-8')


def shared_file(name: str) -> Path:
    """
    Return a file that came with the package, such as config/vehicle.yaml.

    Raises
    ------
    VehicleError
        If no installed copy is found.

    """
    share = Path('share/stri_mapping') / name
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    source = Path(__file__).parent.parent / name
    for path in [source, *(Path(p) / share for p in prefixes if p)]:
        if path.is_file():
            return path
    raise VehicleError(f'{name} was not installed with the package')


def default_vehicle_file() -> Path:
    """Return the config/vehicle.yaml that came with the package."""
    return shared_file('config/vehicle.yaml')


def load_vehicle(path: Path) -> Vehicle:
    """
    Read a vehicle description.

    Raises
    ------
    VehicleError
        Naming the file, the scanner, the field, and what would be right.

    """
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise VehicleError(f'{path}: {error.strerror}') from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise VehicleError(f'{path}: not YAML: {" ".join(str(error).split())}') from None
    try:
        entries = _fields(content, 'the file', required=('scanners',))['scanners']
        if not isinstance(entries, list) or not entries:
            raise VehicleError('scanners: want a list with at least one scanner')
        return Vehicle(tuple(_scanner(e, i) for i, e in enumerate(entries)))
    except VehicleError as error:
        raise VehicleError(f'{path}: {error}') from None


def _scanner(entry: Any, index: int) -> Scanner:
    where = f'scanners[{index}]'
    fields = _fields(entry, where, required=('name', 'role', 'mount'),
                     optional=('frame', 'topic', 'port', 'footprint_pull'))
    name, role = fields['name'], fields['role']
    if not isinstance(name, str) or not re.fullmatch(r'[a-z][a-z0-9_]*', name):
        raise VehicleError(f'{where}.name is {name!r}: want lower-case letters, digits and "_"')
    if role not in ROLES:
        raise VehicleError(f'{name}.role is {role!r}: want {" or ".join(ROLES)}')
    mount = _fields(fields['mount'], f'{name}.mount', required=('xyz', 'rpy'))
    xyz = _triple(mount['xyz'], f'{name}.mount.xyz', 'metres', limit=50.0)
    rpy = _triple(mount['rpy'], f'{name}.mount.rpy', 'radians', limit=2.0 * np.pi + 1e-6)
    port = fields.get('port', {})
    if not isinstance(port, dict):
        raise VehicleError(f'{name}.port is {port!r}: want a mapping such as '
                           '{serial_port: /dev/ttyUSB0}')
    for key in ('frame', 'topic'):
        if key in fields and (not isinstance(fields[key], str) or not fields[key]):
            raise VehicleError(f'{name}.{key} is {fields[key]!r}: want a name')
    pull = _pull(fields['footprint_pull'], name) if 'footprint_pull' in fields else None
    return Scanner(name, role, geometry.transform(xyz, rpy), fields.get('frame', f'{name}_laser'),
                   fields.get('topic', f'{name}/scan'), port, pull)


def _pull(value: Any, name: str) -> float:
    try:
        pull = float(value)                 # YAML takes 4e-5, without a point, for text
    except (TypeError, ValueError):
        pull = np.nan
    if not PULLS[0] <= pull <= PULLS[1]:
        raise VehicleError(f'{name}.footprint_pull is {value!r}: want 1/m from {PULLS[0]:g} to '
                           f'{PULLS[1]:g}')
    return pull


def _fields(entry: Any, where: str, required: tuple[str, ...],
            optional: tuple[str, ...] = ()) -> dict[str, Any]:
    known = ', '.join(required + optional)
    if not isinstance(entry, dict):
        raise VehicleError(f'{where}: want a mapping with the keys {known}')
    for key in entry:
        if key not in required + optional:
            raise VehicleError(f'{where}: unknown key {key!r}; known are {known}')
    for key in required:
        if key not in entry:
            raise VehicleError(f'{where}: key {key!r} is missing')
    return entry


def _triple(value: Any, where: str, unit: str, limit: float) -> Array:
    try:
        triple = np.array([float(v) for v in value])
        if triple.shape != (3,) or not np.all(np.isfinite(triple)):
            raise ValueError
    except (TypeError, ValueError):
        raise VehicleError(f'{where} is {value!r}: want three numbers in {unit}') from None
    if np.any(np.abs(triple) > limit):
        raise VehicleError(f'{where} is {value!r}: over {limit:.4g}; is it in {unit}?')
    return triple
