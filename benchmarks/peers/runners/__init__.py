"""One runner a peer: each runs in that peer's own virtual environment and prints what it has measured."""
