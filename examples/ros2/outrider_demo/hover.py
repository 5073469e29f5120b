"""ROS 2 node that hovers a UAV over its UGV, with the UAV's own observations only.

It needs `outrider ros2 --vehicle uav_0` on the run's router. Each observation arrives as an odometry, its detections
before it; the answer repeats its stamp.
"""

import rclpy
from geometry_msgs.msg import AccelStamped, PointStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node


class Hover(Node):
    def __init__(self):
        super().__init__("hover", namespace="uav_0")
        self.detection = None
        self.answers = self.create_publisher(AccelStamped, "pilot/accel", 10)
        self.create_subscription(PointStamped, "pilot/detection", self.detect, 10)
        self.create_subscription(Odometry, "pilot/odom", self.act, 10)

    def detect(self, detection):
        self.detection = detection.point

    def act(self, odometry):
        velocity = odometry.twist.twist.linear
        x, y = (self.detection.x, self.detection.y) if self.detection is not None else (0.0, 0.0)
        answer = AccelStamped()
        answer.header = odometry.header  # the stamp identifies the observation
        answer.accel.linear.x = 0.2 * x - velocity.x
        answer.accel.linear.y = 0.2 * y - velocity.y
        self.answers.publish(answer)


def main():
    rclpy.init()
    rclpy.spin(Hover())
