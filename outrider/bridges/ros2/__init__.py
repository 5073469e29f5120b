"""ROS 2 over the run's own Zenoh router, in the wire format of rmw_zenoh."""
