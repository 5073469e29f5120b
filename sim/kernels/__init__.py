"""How equations are made fast: compiling, lanes, prefetching, threads."""
