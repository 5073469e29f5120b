"""Sources of the page: a run that is flown now, or a recording that is played."""
