"""Exclude `libraries` from collection: each test there needs a learning library; `make learn-test` installs them."""

collect_ignore = ["libraries"]
