"""Control laws of the paper, one file per section."""
