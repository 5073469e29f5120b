"""How processes talk: what may be said, by whom, and how it travels."""
