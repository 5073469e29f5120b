"""Who decides, knowing only what it may."""
