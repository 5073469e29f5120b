"""Publish a run to ROS 2 nodes, or let them control its vehicles.

ROS 2 messages travel over the run's own Zenoh router, in the wire format of rmw_zenoh.
"""
