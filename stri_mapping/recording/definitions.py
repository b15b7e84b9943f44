# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Message definitions for bags: those of ROS 2 itself, and those of installed packages."""

from __future__ import annotations

import os
from pathlib import Path

from rosbags.typesys import get_types_from_msg, get_typestore, Stores, TypesysError

from stri_mapping.recording.mcap_file import Topic


class Definitions:
    """Knows message types by their definitions, and reads those it does not know yet."""

    def __init__(self) -> None:
        """Begin with the types of ROS 2 Jazzy's own packages."""
        self._store = get_typestore(Stores.ROS2_JAZZY)

    def topic(self, name: str, kind: str, qos: str) -> Topic | None:
        """
        Return what a bag must know of a topic; None where its type's definition is missing.

        Parameters
        ----------
        name
            Of the topic.
        kind
            Its type, such as sensor_msgs/msg/LaserScan.
        qos
            Offered quality of service, a YAML list.

        """
        try:
            self._learn(kind)
            text, _ = self._store.generate_msgdef(kind, ros_version=2)
            return Topic(name, kind, text.encode(), self._store.hash_rihs01(kind), qos)
        except (KeyError, OSError, TypesysError, ValueError):
            return None

    def _learn(self, kind: str) -> None:
        """Register a type and those it is made of from the files of their packages."""
        if kind in self._store.fielddefs:
            return
        found = get_types_from_msg(_definition_file(kind).read_text(encoding='utf-8'), kind)
        for _, fields in found.values():
            for _, field in fields:
                for part in _type_names(field):
                    self._learn(part)
        self._store.register(found)


def _definition_file(kind: str) -> Path:
    package, _, name = kind.split('/')
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        path = Path(prefix) / 'share' / package / 'msg' / f'{name}.msg'
        if path.is_file():
            return path
    raise KeyError(kind)


def _type_names(field: object) -> list[str]:
    """Return the names of message types in a field's description, however it nests them."""
    if isinstance(field, str):
        return [field] if '/msg/' in field else []
    if isinstance(field, tuple):
        return [name for part in field for name in _type_names(part)]
    return []
