"""The truth of a run: the vehicles, the ground, the detections and the clock."""
