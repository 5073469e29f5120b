"""Environments for training, many worlds at once."""
