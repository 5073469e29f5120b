"""Sources of the page: a live run or a recording."""
