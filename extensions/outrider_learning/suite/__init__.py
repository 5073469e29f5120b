"""Benchmark suite: named tasks, a common score, and a leaderboard."""
