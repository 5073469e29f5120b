"""Start, watch and end a run, in several processes or in this one, and sum it up."""
