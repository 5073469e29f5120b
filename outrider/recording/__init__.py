"""Flights in a file: MCAP written while they are flown, and what can be done with it afterwards."""
