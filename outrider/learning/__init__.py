"""Learning on top of the environments: an adapter for Stable-Baselines3, and a policy that was trained with it.

Nothing here but `outrider.learning.sb3` needs Stable-Baselines3 or PyTorch.
"""
