"""The control laws of the paper, one file a section."""
