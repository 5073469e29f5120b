"""Speed of the equations: compiling, lanes, prefetching, threads."""
