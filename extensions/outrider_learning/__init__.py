"""Train policies, and score them on the benchmark's tasks.

The package adapts the environments to Stable-Baselines3 and runs trained policies. Only `outrider_learning.sb3` needs
Stable-Baselines3 or PyTorch.
"""
