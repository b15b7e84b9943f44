# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The README says of nodes, parameters and topics what is so."""

from __future__ import annotations

from pathlib import Path
import re

import live
import pytest

README = Path(__file__).parent.parent / 'README.md'


def test_the_tables_of_parameters_are_those_of_the_declarations():
    describe = pytest.importorskip('stri_mapping.nodes.describe', reason='needs ROS 2')
    text = README.read_text(encoding='utf-8')
    assert describe.BEGIN in text
    assert text == describe.renewed(text), 'run "make readme"'


def test_every_parameter_is_described():
    describe = pytest.importorskip('stri_mapping.nodes.describe', reason='needs ROS 2')
    for config in describe.NODES.values():
        for row in describe.rows(config):
            assert not row.endswith('|  |'), row


@live.needs_ros
def test_the_table_of_topics_is_what_the_nodes_publish(tmp_path):
    rows = {row.split('`')[1]: row.rpartition('|')[0].rpartition('|')[2]
            for row in README.read_text(encoding='utf-8').splitlines()
            if re.match(r'\| `\w+` \|', row) and row.count('|') == 4}
    hidden = {'/rosout', '/parameter_events'}
    nodes = ('stri_estimator', 'facade_aligner')
    with live.listener() as (own, executor, env):
        processes = [live.node(name, {'tf_static_wait': 0.0}, env) for name in nodes]
        with processes[0], processes[1]:
            for name in nodes:
                live.spin_until(executor, lambda n=name: (n, '/') in (
                    own.get_node_names_and_namespaces()), name)
                said = {'/' + topic.lstrip('/')
                        for topic in re.findall('`([a-z_/]+)`', rows[name])}
                if live.find_spec('tf2_msgs') is None:
                    said -= {'/tf', '/tf_static'}

                def published(n=name) -> set[str]:
                    return {topic for topic, _ in own.get_publisher_names_and_types_by_node(
                        n, '/')} - hidden - {'/tf'}

                # /tf comes up with the first odometry
                live.spin_until(executor, lambda p=published, s=said: p() == s - {'/tf'},
                                f'{name} publishing {said}')
