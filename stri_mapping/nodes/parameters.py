# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node parameters from dataclasses: names, types, defaults and descriptions stand once."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass
import inspect
from pathlib import Path
import re
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from stri_mapping.errors import UsageError
from stri_mapping.scan_log import NAME as SCAN_LOG_NAME
from stri_mapping.scan_log import ScanLog
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, Scanner, Vehicle

Config = TypeVar('Config')


def setting(default: Any, lowest: float | None = None, highest: float | None = None,
            live: bool = False) -> Any:
    """
    Return a dataclass field for a parameter with a range, or one that may change at run time.

    Parameters
    ----------
    default
        Its value; its type is the parameter's.
    lowest, highest
        Bounds of a number, both or none.
    live
        Whether the parameter may be set while the node runs.

    """
    return field(default=default, metadata={'range': (lowest, highest), 'live': live})


@dataclass(frozen=True)
class NodeSettings:
    """
    What every processing node can be told.

    Attributes
    ----------
    vehicle_file
        Path of the vehicle description; empty for the one that comes with the package.
    odom_frame
        Frame of the path and of the facade points.
    base_frame
        Frame of the vehicle.
    output
        Folder for the results, written when the node ends; empty for none.
    tf_static_wait
        Seconds to wait at the start for mounts on /tf_static; 0 to take the vehicle file's.
    resume
        Go on with the results in the output folder, as after a crash, instead of anew.

    """

    vehicle_file: str = ''
    odom_frame: str = 'odom'
    base_frame: str = 'base_link'
    output: str = ''
    tf_static_wait: float = setting(3.0, 0.0, 600.0)
    resume: bool = False

    def vehicle(self) -> Vehicle:
        """Read the vehicle description."""
        return load_vehicle(Path(self.vehicle_file) if self.vehicle_file
                            else default_vehicle_file())

    def results_folder(self) -> Path | None:
        """Return the folder for the results, made where it is not there yet."""
        if not self.output:
            return None
        folder = Path(self.output)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f'parameter output: {folder}: {error.strerror}') from None
        return folder

    def scan_log(self, scanner: Scanner) -> ScanLog:
        """Return what keeps count of a scanner's scans, beside the results where there are any."""
        folder = self.results_folder()
        path = folder / SCAN_LOG_NAME.format(scanner.name) if folder else None
        return ScanLog(path, self.resume)


def declare(node: Node, config: type[Config], prefix: str = '') -> Config:
    """
    Declare one parameter for each field of a dataclass, and return their values.

    They are read-only but for those whose `setting` says otherwise.  A field that is a dataclass
    itself gives parameters with a dotted name, ``field.its_field``.

    Raises
    ------
    UsageError
        If a parameter was given a value of another type than its default's or out of its range.

    """
    values: dict[str, Any] = {}
    for name, default, descriptor in described(config):
        values[name] = _declare_one(node, prefix + name, default, descriptor)
    for each in fields(config):  # type: ignore[arg-type]
        if is_dataclass(default := getattr(config(), each.name)):
            values[each.name] = declare(node, type(default), f'{prefix}{each.name}.')
    return config(**values)


def described(config: type[Any]) -> list[tuple[str, Any, ParameterDescriptor]]:
    """Return name, default and descriptor of each plain field of a dataclass."""
    texts = descriptions(config)
    defaults = config()
    found = []
    for each in fields(config):
        default = getattr(defaults, each.name)
        if is_dataclass(default):
            continue
        descriptor = ParameterDescriptor(description=texts.get(each.name, ''),
                                         read_only=not each.metadata.get('live', False))
        lowest, highest = each.metadata.get('range', (None, None))
        if lowest is not None and isinstance(default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(lowest), to_value=float(highest))]
        elif lowest is not None:
            descriptor.integer_range = [
                IntegerRange(from_value=int(lowest), to_value=int(highest))]
        found.append((each.name, default, descriptor))
    return found


def _declare_one(node: Node, name: str, default: object, descriptor: ParameterDescriptor) -> Any:
    try:
        value = node.declare_parameter(name, default, descriptor).value
        return tuple(value) if isinstance(default, tuple) else value
    except InvalidParameterTypeException as error:
        raise UsageError(f'parameter {name}: want a value such as {default!r}: '
                         f'{error.args[0]}') from None
    except InvalidParameterValueException as error:
        given = node._parameter_overrides[name].value       # no public way to ask what was given
        bounds = (*descriptor.floating_point_range, *descriptor.integer_range)[0]
        raise UsageError(f'parameter {name} is {given}: want {bounds.from_value:g} to '
                         f'{bounds.to_value:g}') from error


def descriptions(config: type[Any]) -> dict[str, str]:
    """Return what the docstrings of a class and its bases say of attributes, on one line each."""
    found: dict[str, str] = {}
    for each in reversed(config.__mro__):
        _, _, section = (inspect.getdoc(each) or '').partition('Attributes\n')
        entries = re.findall(r'^(\w[\w, ]*)\n((?:^    .*\n?)+)', section, flags=re.MULTILINE)
        found |= {name: ' '.join(text.split())
                  for names, text in entries for name in names.split(', ')}
    return found
