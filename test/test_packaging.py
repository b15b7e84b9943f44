# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""What an installation gives: one version, imports without ROS, console scripts, colcon."""

from __future__ import annotations

import ast
from importlib.metadata import entry_points
from importlib.util import find_spec
import os
from pathlib import Path
import pkgutil
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

import stri_mapping
from stri_mapping import vehicle

ROOT = Path(__file__).parent.parent
SCRIPTS = {'stri-mapping', 'sick_lms_driver', 'stri_estimator', 'facade_aligner', 'bag_recorder',
           'bag_player', 'virtual_vehicle', 'viewer'}
ROS_PACKAGES = ('rclpy', 'sensor_msgs', 'nav_msgs', 'geometry_msgs', 'std_msgs',
                'diagnostic_msgs', 'rosgraph_msgs', 'builtin_interfaces', 'rcl_interfaces',
                'std_srvs', 'lifecycle_msgs')


def sources() -> list[Path]:
    return sorted((ROOT / 'stri_mapping').rglob('*.py'))


def imported(path: Path) -> set[str]:
    """Return the top-level packages that a module imports anywhere."""
    names = set()
    for statement in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(statement, ast.Import):
            names |= {alias.name.split('.')[0] for alias in statement.names}
        elif isinstance(statement, ast.ImportFrom) and statement.module:
            names.add(statement.module.split('.')[0])
    return names


def test_the_version_is_the_same_everywhere():
    setup = re.search(r"version='([^']+)'", (ROOT / 'setup.py').read_text(encoding='utf-8'))
    manifest = ElementTree.parse(ROOT / 'package.xml').getroot()
    assert setup is not None
    assert setup[1] == manifest.findtext('version') == stri_mapping.__version__


def test_the_manifest_is_format_3_for_ament_python_and_names_what_is_imported():
    manifest = ElementTree.parse(ROOT / 'package.xml').getroot()
    assert manifest.get('format') == '3'
    assert manifest.findtext('export/build_type') == 'ament_python'
    depends = {element.text for element in manifest.iter('exec_depend')}
    used = set().union(*(imported(path) for path in sources()))
    assert {name for name in used if name.endswith('_msgs') or name in ROS_PACKAGES} <= depends


def test_only_the_nodes_import_ros():
    for path in sources():
        if 'nodes' not in path.relative_to(ROOT).parts:
            ros = {n for n in imported(path) if n.endswith('_msgs') or n in ROS_PACKAGES}
            assert not ros, f'{path} imports {ros}'


def test_everything_but_the_nodes_can_be_imported_without_ros():
    modules = [m.name for m in pkgutil.walk_packages(stri_mapping.__path__, 'stri_mapping.')
               if not m.name.startswith('stri_mapping.nodes')] if find_spec('trimesh') else []
    code = (f'import sys; [sys.modules.__setitem__(m, None) for m in {ROS_PACKAGES}]; '
            f'from importlib import import_module; [import_module(m) for m in {modules}]')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr


def test_a_node_without_ros_says_what_to_install():
    code = ('import importlib.util as u; find = u.find_spec; '
            'u.find_spec = lambda n, *a: None if n == "rclpy" else find(n, *a); '
            'import stri_mapping.nodes.stri_estimator')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          check=False, cwd=ROOT)
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1
    assert 'stri_mapping[ros]' in done.stderr


def test_every_source_file_begins_with_its_licence():
    for path in [*sources(), *sorted((ROOT / 'test').glob('*.py')), ROOT / 'setup.py']:
        first, second = path.read_text(encoding='utf-8').splitlines()[:2]
        assert first == '# Copyright 2026 The stri_mapping authors', path
        assert second == '# SPDX-License-Identifier: Apache-2.0', path


def test_the_default_vehicle_is_found():
    assert vehicle.load_vehicle(vehicle.default_vehicle_file()).horizontal.name == 'horizontal'


def test_console_scripts_are_installed_where_pip_puts_them():
    assert SCRIPTS <= {point.name for point in entry_points(group='console_scripts')
                       if point.value.startswith('stri_mapping.')}
    scripts = Path(sys.executable).parent
    if not (scripts / 'stri-mapping').exists():
        pytest.skip('the package is not installed by pip here')
    done = subprocess.run([scripts / 'stri-mapping', '--help'], capture_output=True, text=True,
                          check=True)
    assert 'COMMAND' in done.stdout
    assert {name for name in SCRIPTS if (scripts / name).exists()} == SCRIPTS


@pytest.mark.skipif(shutil.which('colcon', path=os.fspath(Path(sys.executable).parent)) is None,
                    reason='colcon is not installed: pip install colcon-common-extensions')
def test_colcon_puts_executables_and_shared_files_where_ros_looks(tmp_path):
    package = tmp_path / 'src' / 'stri_mapping'
    shutil.copytree(ROOT, package, ignore=shutil.ignore_patterns(
        '.git', '.venv', 'bags', 'out', 'build', 'install', 'log', '*.egg-info', '__pycache__'))
    colcon = Path(sys.executable).parent / 'colcon'
    done = subprocess.run([colcon, 'build', '--event-handlers', 'console_direct+'], cwd=tmp_path,
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    prefix = tmp_path / 'install' / 'stri_mapping'
    assert {p.name for p in (prefix / 'lib' / 'stri_mapping').iterdir()} == SCRIPTS
    share = prefix / 'share'
    assert (share / 'ament_index/resource_index/packages/stri_mapping').is_file()
    assert (share / 'stri_mapping/package.xml').is_file()
    assert (share / 'stri_mapping/config/vehicle.yaml').is_file()
    launched = subprocess.run([prefix / 'lib/stri_mapping/stri-mapping', '--version'],
                              capture_output=True, text=True, check=False)
    assert launched.stdout.strip() == f'stri-mapping {stri_mapping.__version__}'
