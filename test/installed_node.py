"""
Start an installed filter_node, send it measurements from this process, and see poses come back.

usage: installed_node.py EXECUTABLE PARAMS_FILE
"""

import math
import signal
import subprocess
import sys
import time

from geometry_msgs.msg import PoseWithCovarianceStamped
import rclpy
from std_msgs.msg import Float64MultiArray

LIMIT_S = 30.0


def main() -> None:
    executable, params_file = sys.argv[1:]
    command = [executable, '--ros-args', '--params-file', params_file]
    filter_process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        pose = first_pose(filter_process)
        print(f'a pose at {pose.pose.pose.position}')
        filter_process.send_signal(signal.SIGINT)
        _, errors = filter_process.communicate(timeout=LIMIT_S)
    finally:
        filter_process.kill()
    assert (filter_process.returncode, errors) == (0, ''), (filter_process.returncode, errors)
    print('ended by SIGINT with status 0 and nothing on stderr')


def first_pose(filter_process: subprocess.Popen) -> PoseWithCovarianceStamped:
    """Measure until a pose is received, and check that it is one."""
    rclpy.init()
    node = rclpy.create_node('installed_node_test')
    poses: list[PoseWithCovarianceStamped] = []
    node.create_subscription(PoseWithCovarianceStamped, '/filter_node/pose', poses.append, 10)
    publisher = node.create_publisher(Float64MultiArray, 'measurement', 10)

    deadline = time.monotonic() + LIMIT_S
    while not poses:
        if filter_process.poll() is not None:
            sys.exit(f'filter_node ended: {filter_process.communicate()[1]}')
        if time.monotonic() > deadline:
            sys.exit(f'no pose within {LIMIT_S} s; matched: {publisher.get_subscription_count()} '
                     f'subscription, {node.count_publishers("/filter_node/pose")} publisher')
        if publisher.get_subscription_count():
            publisher.publish(Float64MultiArray(data=[0.5, 0.5]))
        rclpy.spin_once(node, timeout_sec=0.1)

    rclpy.shutdown()
    pose = poses[0]
    assert pose.header.frame_id == 'map'
    assert math.isfinite(pose.pose.pose.position.x) and math.isfinite(pose.pose.pose.position.y)
    assert pose.pose.covariance[0] > 0.0 and pose.pose.covariance[7] > 0.0
    return pose


if __name__ == '__main__':
    main()
