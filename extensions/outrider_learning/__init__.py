"""Train policies, and score them over the benchmark's tasks.

Learning on top of the environments: an adapter for Stable-Baselines3, and a policy that was trained with it.

Nothing here but `outrider_learning.sb3` needs Stable-Baselines3 or PyTorch.
"""
