"""Recordings of flights as MCAP files: writing, reading, repair, and a second flight of the commands."""
