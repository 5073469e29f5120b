"""Teleoperation of a UGV from a terminal: keys, link to the bus, map and screen."""
