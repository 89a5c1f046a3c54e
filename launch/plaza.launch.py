"""Find a robot from ranges alone, on a real recording: ros2 launch pif_ros plaza.launch.py."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    params_file = PathJoinSubstitution(
        [FindPackageShare('pif_ros'), 'config', LaunchConfiguration('config')])
    return LaunchDescription([
        DeclareLaunchArgument(
            'config', default_value='plaza_range_only.yaml',
            description='or plaza_unicycle.yaml, which uses the odometry too'),
        DeclareLaunchArgument(
            'speed', default_value='10.0',
            description='1 is real time, 0 as fast as the filter keeps up'),
        Node(
            package='pif_ros',
            executable='filter_node',
            parameters=[params_file],
            output='screen'),
        Node(
            package='pif_ros',
            executable='plaza_player',
            parameters=[
                {'speed': ParameterValue(LaunchConfiguration('speed'), value_type=float)}],
            output='screen'),
    ])
