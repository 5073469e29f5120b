"""Connect a run or its vehicles to ROS 2.

ROS 2 messages travel over the run's own Zenoh router, in the wire format of rmw_zenoh.
"""
