"""Where the page has its news from: a run that is flown now, or a recording that is played."""
