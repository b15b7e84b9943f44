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
        'plyfile',
        'rich',
        'rosbags>=0.10',
        'scipy',
    ],
    extras_require={
        # For machines without an installed ROS 2; never mixed with one from apt.
        'ros': ['ros-jazzy-common-interfaces==5.3.6', 'ros-jazzy-rclpy[fastrtps]==7.1.6'],
        'simulation': ['embreex'],
        'test': ['colcon-common-extensions', 'hypothesis', 'mypy', 'pytest', 'ruff',
                 'types-PyYAML'],
    },
    zip_safe=True,
    maintainer='The stri_mapping authors',
    maintainer_email='stri_mapping@example.org',
    description="Map a street's facades live from a moving vehicle with SICK line scanners alone.",
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'stri-mapping = stri_mapping.cli:main',
            'stri_estimator = stri_mapping.nodes.stri_estimator:main',
            'facade_aligner = stri_mapping.nodes.facade_aligner:main',
            'bag_player = stri_mapping.nodes.bag_player:main',
        ],
    },
)
