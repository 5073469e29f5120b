"""Fly a rigid-body quadrotor below the reference model, and measure its tracking error."""
