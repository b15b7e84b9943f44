# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Launch files and configuration: run where ROS 2's launch system is, read as text elsewhere."""

from __future__ import annotations

import ast
from importlib.util import find_spec
import json
import os
from pathlib import Path
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import live
import numpy as np
import pytest
import yaml

from stri_mapping.bag_io import Bag
from stri_mapping.facade.cloud_files import read_ply
from stri_mapping.summary import read_summary
from stri_mapping.trajectory import read_tum

ROOT = Path(__file__).parent.parent
LAUNCH, CONFIG = ROOT / 'launch', ROOT / 'config'
TOP = ('bringup', 'replay', 'simulation')
TOPICS = {'/odom', '/velocity', '/trajectory', '/facade/points', '/facade/map', '/stri/segments',
          '/horizontal/scan', '/vertical_fore/scan', '/vertical_side/scan', '/vertical_aft/scan',
          '/ground_truth/odom', '/diagnostics'}


def calls(path: Path, name: str) -> list[ast.Call]:
    """Return the calls of a function in a file."""
    tree = ast.parse(path.read_text(encoding='utf-8'))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name) and node.func.id == name]


def settings_classes() -> dict[str, type]:
    return pytest.importorskip('stri_mapping.nodes.describe', reason='needs ROS 2').NODES


@pytest.mark.parametrize('name', TOP)
def test_each_launch_file_has_its_parameters_beside_it(name):
    assert (LAUNCH / f'{name}_launch.py').is_file()
    assert (CONFIG / f'{name}.yaml').is_file()


@pytest.mark.parametrize('path', sorted(LAUNCH.glob('*.py')), ids=lambda p: p.name)
def test_every_argument_is_described_and_every_file_has_its_function(path):
    tree = ast.parse(path.read_text(encoding='utf-8'))
    assert 'generate_launch_description' in {
        node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    for call in calls(path, 'DeclareLaunchArgument'):
        assert 'description' in {keyword.arg for keyword in call.keywords}


@pytest.mark.parametrize('name', TOP)
def test_the_files_of_parameters_name_parameters_that_exist_with_their_type(name):
    nodes = settings_classes()
    from stri_mapping.nodes.parameters import described
    content = yaml.safe_load((CONFIG / f'{name}.yaml').read_text(encoding='utf-8'))
    for node, section in content.items():
        known = {name: default
                 for name, default, _ in described(nodes[node.rpartition('/')[2]])}
        for parameter, value in section['ros__parameters'].items():
            assert type(value) is type(known[parameter]), f'{node}: {parameter}'


def test_the_diagnostic_groups_catch_what_the_nodes_say():
    content = yaml.safe_load((CONFIG / 'diagnostic_aggregator.yaml').read_text(encoding='utf-8'))
    groups = content['analyzers']['ros__parameters']
    said = ['horizontal/sick_lms_driver: scanner', 'stri_estimator: motion',
            'facade_aligner: facades', 'bag_recorder: recording', 'bag_player: playing',
            'viewer: viewing']
    sources = ' '.join(p.read_text(encoding='utf-8') for p in (
        ROOT / 'stri_mapping/nodes').glob('*.py'))
    for text in said:
        group, = [g for g in groups.values() if isinstance(g, dict) and (
            text in g.get('expected', []) or any(part in text for part in g.get('contains', []))
            or any(text.startswith(part) for part in g.get('startswith', [])))]
        assert group['type'] == 'diagnostic_aggregator/GenericAnalyzer'
        assert f"Diagnostics(self, {{'{text.partition(': ')[2]}'" in sources or (
            f"Diagnostics(self.node, {{'{text.partition(': ')[2]}'" in sources)


def test_the_layouts_show_topics_that_exist():
    rviz = yaml.safe_load((CONFIG / 'stri_mapping.rviz').read_text(encoding='utf-8'))
    manager = rviz['Visualization Manager']
    assert manager['Global Options']['Fixed Frame'] == 'odom'
    shown = {d['Topic']['Value'] for d in manager['Displays'] if 'Topic' in d}
    assert shown
    assert shown <= TOPICS
    foxglove = json.loads((CONFIG / 'foxglove_layout.json').read_text(encoding='utf-8'))
    three = next(v for k, v in foxglove['configById'].items() if k.startswith('3D!'))
    assert set(three['topics']) <= TOPICS

    def panels(layout):
        return [layout] if isinstance(layout, str) else [
            *panels(layout['first']), *panels(layout['second'])]

    assert set(panels(foxglove['layout'])) == set(foxglove['configById'])
    plot = ElementTree.parse(CONFIG / 'plotjuggler_layout.xml')
    curves = [curve.get('curve_x') or curve.get('name') for curve in plot.iter('curve')]
    assert all(any(curve.startswith(topic) for topic in TOPICS) for curve in curves)


def fields_of(kind: str) -> dict[str, str]:
    """Return the types of a message's fields by their names."""
    module, name = kind.split('/msg/')
    return vars(pytest.importorskip(f'{module}.msg'))[name].get_fields_and_field_types()


def field_type(kind: str, path: list[str]) -> str:
    """Return the type of a field however deep; KeyError where there is none."""
    for name in path:
        kind = fields_of(kind.replace('/', '/msg/') if '/msg/' not in kind else kind)[name]
    return kind


# Types of the topics that layouts take figures from.
PLOTTED = {'/velocity': 'geometry_msgs/msg/TwistWithCovarianceStamped',
           '/odom': 'nav_msgs/msg/Odometry', '/ground_truth/odom': 'nav_msgs/msg/Odometry'}
# What each kind of RViz display shows, and the topics of that type.
DISPLAYED = {'PointCloud2': {'/facade/map', '/facade/points'}, 'Path': {'/trajectory'},
             'Odometry': {'/odom', '/ground_truth/odom'},
             'Image': {'/stri/image', '/stri/segments'},
             'LaserScan': {topic for topic in TOPICS if topic.endswith('/scan')}}


def test_every_figure_of_the_plots_is_a_number_in_a_message():
    plot = ElementTree.parse(CONFIG / 'plotjuggler_layout.xml')
    paths = [text for curve in plot.iter('curve') for text in (
        [curve.get('curve_x'), curve.get('curve_y')] if curve.get('curve_x')
        else [curve.get('name')])]
    foxglove = json.loads((CONFIG / 'foxglove_layout.json').read_text(encoding='utf-8'))
    paths += [each['value'].replace('.', '/') for name, panel in foxglove['configById'].items()
              if name.startswith('Plot!') for each in panel['paths']]
    assert len(paths) > 8
    for path in paths:
        topic = next(topic for topic in PLOTTED if path.startswith(topic + '/'))
        kind = field_type(PLOTTED[topic], path[len(topic) + 1:].split('/'))
        assert kind == 'double', path
    selected = {topic.get('name') for topic in plot.iter('topic')}
    assert selected >= {topic for topic in PLOTTED if any(p.startswith(topic) for p in paths)}


def test_the_displays_of_rviz_fit_what_their_topics_carry_and_offer():
    rviz = yaml.safe_load((CONFIG / 'stri_mapping.rviz').read_text(encoding='utf-8'))
    for display in rviz['Visualization Manager']['Displays']:
        kind = display['Class'].removeprefix('rviz_default_plugins/')
        if 'Topic' in display:
            topic = display['Topic']
            assert topic['Value'] in DISPLAYED[kind]
            # a durable reader never hears a volatile writer
            latched = topic['Value'] in ('/trajectory', '/facade/map')
            assert topic['Durability Policy'] == ('Transient Local' if latched else 'Volatile')


def test_the_service_file_runs_a_command_that_exists():
    from stri_mapping import cli
    text = (CONFIG / 'stri-mapping.service').read_text(encoding='utf-8')
    line = next(row for row in text.splitlines() if row.startswith('ExecStart='))
    arguments = line.partition('stri-mapping ')[2].split()
    args = cli.make_parser(arguments).parse_args(arguments)
    assert args.command == 'run'
    assert args.record == Path('recordings')


@pytest.fixture
def prefix(tmp_path):
    """Return a prefix as colcon makes it."""
    share = tmp_path / 'share'
    (share / 'ament_index/resource_index/packages').mkdir(parents=True)
    (share / 'ament_index/resource_index/packages/stri_mapping').touch()
    for folder in (LAUNCH, CONFIG):
        shutil.copytree(folder, share / 'stri_mapping' / folder.name)
    programs = tmp_path / 'lib/stri_mapping'
    programs.mkdir(parents=True)
    for node in ('stri_estimator', 'facade_aligner', 'bag_player', 'bag_recorder',
                 'sick_lms_driver', 'virtual_vehicle'):
        program = programs / node
        program.write_text(f'#!/bin/sh\nexec {sys.executable} -m stri_mapping.nodes.{node} "$@"\n',
                           encoding='utf-8')
        program.chmod(0o755)
    return tmp_path


needs_launch = pytest.mark.skipif(
    find_spec('rclpy') is None or find_spec('launch_ros') is None,
    reason="needs ROS 2's launch_ros")
# "ros2 launch", which ROS 2 from pip lacks
LAUNCHER = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
service = LaunchService(noninteractive=True)
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(
    PythonLaunchDescriptionSource(sys.argv[1]),
    launch_arguments=[tuple(each.split(':=')) for each in sys.argv[2:]])]))
sys.exit(service.run())
"""


def launched(prefix: Path, name: str, **arguments: object) -> str:
    """Run a launch file to its end; return its output."""
    env = live.environment()
    env['AMENT_PREFIX_PATH'] = os.pathsep.join(
        [str(prefix), os.environ.get('AMENT_PREFIX_PATH', sys.prefix)])
    done = subprocess.run(
        [sys.executable, '-c', LAUNCHER, prefix / f'share/stri_mapping/launch/{name}_launch.py',
         *(f'{key}:={value}' for key, value in arguments.items())],
        env=env, capture_output=True, text=True, timeout=live.TIMEOUT, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@needs_launch
def test_a_bag_is_mapped_by_the_launch_file(prefix, tmp_path):
    bag = live.cut_bag(live.CAMPUS, tmp_path / 'short', 5.0)
    launched(prefix, 'replay', bag=bag, output=tmp_path / 'out', record=tmp_path / 'bag')
    # all nodes were stopped at once, and yet every scan has its pose and the last its points
    with Bag(bag) as played:
        assert live.line_count(tmp_path / 'out/trajectory.tum') == played.message_count(
            '/horizontal/scan')
    end = read_tum(tmp_path / 'out/trajectory.tum').stamps_ns[-1] * 1e-9
    times = np.concatenate([rows['time'] for rows in read_ply(tmp_path / 'out/facade.ply')])
    assert times.max() > end - 0.03
    assert (tmp_path / 'out/facade.laz').is_file()
    assert (tmp_path / 'bag/metadata.yaml').is_file()


@needs_launch
@pytest.mark.skipif(find_spec('embreex') is None, reason='needs stri_mapping[simulation]')
def test_a_virtual_drive_by_the_launch_file_takes_the_drivers_from_state_to_state(
        prefix, tmp_path):
    output = launched(prefix, 'simulation', duration=3.0, ports=tmp_path / 'ports',
                      output=tmp_path / 'out', record=tmp_path / 'bag')
    assert 'Traceback' not in output
    summary = read_summary(tmp_path / 'out')
    assert [s['lost_scans'] for s in summary['scanners']] == 4 * [0]
    # standing still until all is ready, 3 s before the drive, and after it
    assert all(s['scans'] > 75 * 6 for s in summary['scanners'])
    assert summary['points'] > 0
