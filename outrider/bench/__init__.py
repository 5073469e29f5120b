"""The speed of each layer, and in the same run the limit that it stands beside."""
