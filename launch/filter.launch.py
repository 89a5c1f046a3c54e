"""Start one filter_node: ros2 launch pif_ros filter.launch.py params_file:=my_robot.yaml."""

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
            'params_file',
            default_value=PathJoinSubstitution([config, 'coupled_trigonometric.yaml']),
            description='Parameters, under the full name of the node or under /**'),
        DeclareLaunchArgument(
            'namespace', default_value='', description='Namespace of the node'),
        DeclareLaunchArgument(
            'name', default_value='filter_node', description='Name of the node'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='false',
            description='Take the time from /clock, where params_file does not say'),
        DeclareLaunchArgument(
            'log_level', default_value='info', description='Least severity that is logged'),
        Node(
            package='pif_ros',
            executable='filter_node',
            namespace=LaunchConfiguration('namespace'),
            name=LaunchConfiguration('name'),
            parameters=[
                {'use_sim_time': ParameterValue(
                    LaunchConfiguration('use_sim_time'), value_type=bool)},
                LaunchConfiguration('params_file'),
            ],
            arguments=['--ros-args', '--log-level', LaunchConfiguration('log_level')],
            output='screen'),
    ])
