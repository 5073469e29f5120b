"""What is true: the vehicles, the ground, the detections and the clock."""
