"""Observations for learning: each transformation once, for one world and for a batch of worlds alike.

`outrider.envs.wrappers` puts them around environments.
"""
