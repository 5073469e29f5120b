"""Runners of the peers: each runs in the peer's virtual environment and prints its measurements."""
