"""Environments for training, in many worlds at once."""
