"""Start filters of many targets: ros2 launch pif_ros filter_bank.launch.py targets:='[alpha]'."""

from typing import List

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    config = PathJoinSubstitution([FindPackageShare('pif_ros'), 'config'])
    return LaunchDescription([
        DeclareLaunchArgument(
            'params_file', default_value=PathJoinSubstitution([config, 'filter_bank.yaml']),
            description='Parameters of all targets, and of single ones'),
        DeclareLaunchArgument(
            'targets', default_value="['alpha', 'bravo']",
            description='Who is tracked by this process, whatever params_file says'),
        DeclareLaunchArgument(
            'namespace', default_value='', description='Namespace above those of the targets'),
        DeclareLaunchArgument(
            'log_level', default_value='info', description='Least severity that is logged'),
        Node(
            package='pif_ros',
            executable='filter_bank',
            namespace=LaunchConfiguration('namespace'),
            # by name, so that it counts for more than what a file has for all nodes
            name='filter_bank',
            parameters=[
                LaunchConfiguration('params_file'),
                {'targets': ParameterValue(LaunchConfiguration('targets'), value_type=List[str])},
            ],
            arguments=['--ros-args', '--log-level', LaunchConfiguration('log_level')],
            output='screen'),
    ])
