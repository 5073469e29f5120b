"""Show a run to ROS 2 nodes, or let them fly its vehicles.

ROS 2 over the run's own Zenoh router, in the wire format of rmw_zenoh.
"""
