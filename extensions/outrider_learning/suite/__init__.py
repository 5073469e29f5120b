"""The benchmark suite: named tasks, the score they share, and the leaderboard of whoever has flown them."""
