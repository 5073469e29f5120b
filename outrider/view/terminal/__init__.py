"""Driving a UGV from a terminal: the wheel (keys to velocity), the link (the bus), the map and the screen."""
