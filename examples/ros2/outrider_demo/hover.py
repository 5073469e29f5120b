"""A UAV flown by a ROS 2 node: it hovers over its UGV, and knows what the UAV is told and nothing else.

Needs `outrider ros2 --vehicle uav_0` on the run's router. Each observation comes as an odometry, the detections before
it; the answer carries its stamp.
"""

import rclpy
from geometry_msgs.msg import AccelStamped, PointStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node


class Hover(Node):
    def __init__(self):
        super().__init__("hover", namespace="uav_0")
        self.seen = None
        self.answers = self.create_publisher(AccelStamped, "pilot/accel", 10)
        self.create_subscription(PointStamped, "pilot/detection", self.detect, 10)
        self.create_subscription(Odometry, "pilot/odom", self.act, 10)

    def detect(self, detection):
        self.seen = detection.point

    def act(self, odometry):
        velocity = odometry.twist.twist.linear
        x, y = (self.seen.x, self.seen.y) if self.seen is not None else (0.0, 0.0)
        answer = AccelStamped()
        answer.header = odometry.header  # its stamp says which observation this answers
        answer.accel.linear.x = 0.2 * x - velocity.x
        answer.accel.linear.y = 0.2 * y - velocity.y
        self.answers.publish(answer)


def main():
    rclpy.init()
    rclpy.spin(Hover())
