# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Node parameters from dataclasses: names, types, defaults and descriptions stand once."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
import inspect
from pathlib import Path
import re
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node

from stri_mapping.errors import UsageError
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, Vehicle

Config = TypeVar('Config')


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

    """

    vehicle_file: str = ''
    odom_frame: str = 'odom'
    base_frame: str = 'base_link'
    output: str = ''
    tf_static_wait: float = 3.0

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


def declare(node: Node, config: type[Config], prefix: str = '') -> Config:
    """
    Declare one read-only parameter for each field of a dataclass, and return their values.

    A field that is a dataclass itself gives parameters with a dotted name, ``field.its_field``.

    Raises
    ------
    UsageError
        If a parameter was given a value of another type than its default's.

    """
    described = descriptions(config)
    defaults = config()
    values: dict[str, Any] = {}
    for field in fields(config):  # type: ignore[arg-type]
        default, name = getattr(defaults, field.name), prefix + field.name
        if is_dataclass(default):
            values[field.name] = declare(node, type(default), f'{name}.')
        else:
            values[field.name] = _declare_one(node, name, default,
                                              described.get(field.name, ''))
    return config(**values)


def _declare_one(node: Node, name: str, default: object, description: str) -> Any:
    descriptor = ParameterDescriptor(description=description, read_only=True)
    try:
        value = node.declare_parameter(name, default, descriptor).value
        return tuple(value) if isinstance(default, tuple) else value
    except InvalidParameterTypeException as error:
        raise UsageError(f'parameter {name}: want a value such as {default!r}: '
                         f'{error.args[0]}') from None


def descriptions(config: type[Any]) -> dict[str, str]:
    """Return what the class's docstring says of each attribute, on one line."""
    _, _, section = (inspect.getdoc(config) or '').partition('Attributes\n')
    entries = re.findall(r'^(\w[\w, ]*)\n((?:^    .*\n?)+)', section, flags=re.MULTILINE)
    return {name: ' '.join(text.split()) for names, text in entries for name in names.split(', ')}
