# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The vehicle description: what the shipped one says, and how faults are named."""

import numpy as np
import pytest
import yaml

from stri_mapping.errors import VehicleError
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, write_vehicle


@pytest.fixture
def content():
    return yaml.safe_load(default_vehicle_file().read_text())


def load(tmp_path, content):
    path = tmp_path / 'vehicle.yaml'
    path.write_text(yaml.safe_dump(content))
    return load_vehicle(path)


def test_the_default_vehicle_looks_left_with_upright_vertical_scanners():
    vehicle = load_vehicle(default_vehicle_file())
    assert vehicle.horizontal.frame == 'horizontal_laser'
    np.testing.assert_allclose(vehicle.horizontal.planar_mount, [0.0, 0.6, np.pi / 2])
    names = [s.name for s in vehicle.verticals]
    assert names == ['vertical_fore', 'vertical_side', 'vertical_aft']
    for scanner, azimuth in zip(vehicle.verticals, (45.0, 90.0, 135.0)):
        R = scanner.T_base_laser[:3, :3]
        a = np.deg2rad(azimuth)
        np.testing.assert_allclose(R[:, 0], [np.cos(a), np.sin(a), 0.0], atol=1e-12)
        np.testing.assert_allclose(R[:, 1], [0.0, 0.0, 1.0], atol=1e-12)      # laser y is up


def set_in(content, path, value):
    for key in path[:-1]:
        content = content[key]
    content[path[-1]] = value


@pytest.mark.parametrize(('path', 'value', 'message'), [
    (['scanners'], [], 'at least one scanner'),
    (['scanner'], [], "unknown key 'scanner'"),
    (['scanners', 0, 'role'], 'sideways', 'want horizontal or vertical'),
    (['scanners', 0, 'role'], 'vertical', '0 scanners with role horizontal'),
    (['scanners', 1, 'role'], 'horizontal', '2 scanners with role horizontal'),
    (['scanners', 0, 'name'], 'Front Left', 'lower-case'),
    (['scanners', 0, 'postion'], [0, 0, 0], "unknown key 'postion'"),
    (['scanners', 1, 'name'], 'horizontal', 'used by more than one'),
    (['scanners', 0, 'mount', 'rpy'], [0, 0, 90.0], 'is it in radians'),
    (['scanners', 0, 'mount', 'xyz'], [600, 0, 1200], 'is it in metres'),
    (['scanners', 0, 'mount', 'xyz'], [0, 0], 'three numbers in metres'),
    (['scanners', 0, 'mount', 'xyz'], 'front', 'three numbers in metres'),
    (['scanners', 0, 'mount'], 5, 'want a mapping'),
    (['scanners', 0, 'port'], 'ttyUSB0', 'want a mapping such as'),
    (['scanners', 0, 'topic'], 7, 'topic is 7'),
    (['scanners', 0, 'footprint_pull'], 4.0, 'want 1/m from -3e-05 to 9e-05'),
    (['scanners', 0, 'footprint_pull'], 'little', 'want 1/m from -3e-05 to 9e-05'),
])
def test_faults_are_named_with_file_and_field(tmp_path, content, path, value, message):
    set_in(content, path, value)
    with pytest.raises(VehicleError, match=message) as caught:
        load(tmp_path, content)
    assert str(caught.value).startswith(str(tmp_path / 'vehicle.yaml'))
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('written', [4e-5, '4e-5'])
def test_the_footprint_pull_is_read_and_written_again(tmp_path, content, written):
    content['scanners'][0]['footprint_pull'] = written
    path = tmp_path / 'vehicle.yaml'
    path.write_text(yaml.safe_dump(content))
    for _ in range(2):
        vehicle = load_vehicle(path)
        assert vehicle.horizontal.footprint_pull == 4e-5
        assert vehicle.verticals[0].footprint_pull is None
        write_vehicle(path, vehicle)


def test_a_missing_key_is_named(tmp_path, content):
    del content['scanners'][2]['mount']
    with pytest.raises(VehicleError, match=r"scanners\[2\]: key 'mount' is missing"):
        load(tmp_path, content)


def test_files_that_are_not_yaml_or_not_there(tmp_path):
    broken = tmp_path / 'broken.yaml'
    broken.write_text('scanners: [')
    with pytest.raises(VehicleError, match='not YAML'):
        load_vehicle(broken)
    with pytest.raises(VehicleError, match='No such file'):
        load_vehicle(tmp_path / 'absent.yaml')


def test_an_upright_scanner_cannot_be_horizontal(tmp_path, content):
    content['scanners'][0]['mount']['rpy'] = [np.pi / 2, 0.0, 0.0]
    scanner = load(tmp_path, content).horizontal
    with pytest.raises(VehicleError, match='tilted by 90 degrees'):
        print(scanner.planar_mount)
