# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
The README's tables of parameters, from the declarations themselves.

    python -m stri_mapping.nodes.describe README.md        renews them in the file
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
import re
import sys
from typing import Any

from stri_mapping.nodes.bag_player import PlayerSettings
from stri_mapping.nodes.bag_recorder import RecorderSettings
from stri_mapping.nodes.parameters import described, NodeSettings
from stri_mapping.nodes.sick_lms_driver import DriverSettings
from stri_mapping.nodes.stri_estimator import EstimatorSettings
from stri_mapping.nodes.viewer import ViewerSettings
from stri_mapping.nodes.virtual_vehicle import VirtualVehicleSettings

NODES = {
    'sick_lms_driver': DriverSettings, 'stri_estimator': EstimatorSettings,
    'facade_aligner': NodeSettings, 'bag_recorder': RecorderSettings,
    'bag_player': PlayerSettings, 'virtual_vehicle': VirtualVehicleSettings,
    'viewer': ViewerSettings}
BEGIN, END = '<!-- parameters, generated -->\n', '<!-- end of parameters -->\n'
TYPES = {bool: 'bool', int: 'int', float: 'double', str: 'string'}


def rows(config: type[Any], prefix: str = '') -> Iterator[str]:
    """Iterate over the table's rows for the parameters of a settings class."""
    for name, default, descriptor in described(config):
        kind = TYPES.get(type(default), 'list')
        bounds = [*descriptor.floating_point_range, *descriptor.integer_range]
        limits = f'{bounds[0].from_value:g} to {bounds[0].to_value:g}' if bounds else ''
        value = {'True': 'true', 'False': 'false', '': "''"}.get(str(default), str(default))
        text = descriptor.description + ('' if descriptor.read_only else ' (*live*)')
        yield f'| `{prefix}{name}` | {kind} | `{value}` | {limits} | {text} |'
    for each in fields(config):
        if is_dataclass(inner := getattr(config(), each.name)):
            yield from rows(type(inner), f'{prefix}{each.name}.')


def tables() -> str:
    """Return the tables of all nodes."""
    parts = [BEGIN]
    for node, config in NODES.items():
        parts.append(f'\n<details><summary><code>{node}</code></summary>\n\n'
                     '| parameter | type | default | range | meaning |\n|---|---|---|---|---|\n')
        parts += [f'{row}\n' for row in rows(config)]
        parts.append('\n</details>\n')
    return ''.join([*parts, '\n', END])


def renewed(text: str) -> str:
    """Return a text with the tables between its marks made anew."""
    pattern = re.escape(BEGIN) + '.*?' + re.escape(END)
    return re.sub(pattern, lambda _: tables(), text, flags=re.DOTALL)


if __name__ == '__main__':
    target = Path(sys.argv[1])
    target.write_text(renewed(target.read_text(encoding='utf-8')), encoding='utf-8')
