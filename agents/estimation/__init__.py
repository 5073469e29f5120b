"""The relative position of the UGV from noisy and late detections."""
