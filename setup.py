# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

package_name = 'stri_mapping'

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(include=[package_name, f'{package_name}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        (f'share/{package_name}/config', glob('config/*')),
        (f'share/{package_name}/launch', glob('launch/*launch.py')),
    ],
    python_requires='>=3.10,<3.14',
    install_requires=[
        'PyYAML',
        'laspy[lazrs]>=2.5',
        'matplotlib',
        'numba',
        'numpy',
        'pillow',
        'plyfile',
        'pyserial',
        'rich',
        'rosbags>=0.10',
        'scipy',
        'setproctitle',
    ],
    extras_require={
        # For machines without an installed ROS 2; never mixed with one from apt.
        'ros': ['ros-jazzy-common-interfaces==5.3.6', 'ros-jazzy-rclpy[fastrtps]==7.1.6'],
        'simulation': ['embreex'],
        'viewer': ['foxglove-sdk>=0.16'],
        # Further formats of the cloud: `map --pcd` and `map --e57`.
        'pcd': ['pypcd4'],
        'e57': ['pye57'],
        'test': ['colcon-common-extensions', 'cyclonedds', 'hypothesis', 'mcap', 'mypy', 'pye57',
                 'pypcd4', 'pytest', 'pytest-rerunfailures', 'ruff', 'types-PyYAML',
                 'websockets', 'zstandard'],
    },
    zip_safe=True,
    maintainer='The stri_mapping authors',
    maintainer_email='stri_mapping@example.org',
    description="Map a street's facades live from a moving vehicle with SICK line scanners alone.",
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'stri-mapping = stri_mapping.cli:main',
            'sick_lms_driver = stri_mapping.nodes.sick_lms_driver:main',
            'stri_estimator = stri_mapping.nodes.stri_estimator:main',
            'facade_aligner = stri_mapping.nodes.facade_aligner:main',
            'bag_player = stri_mapping.nodes.bag_player:main',
            'bag_recorder = stri_mapping.nodes.bag_recorder:main',
            'viewer = stri_mapping.nodes.viewer:main',
            'virtual_vehicle = stri_mapping.nodes.virtual_vehicle:main',
        ],
    },
)
