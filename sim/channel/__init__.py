"""What a radio link does to messages, in simulated time."""
