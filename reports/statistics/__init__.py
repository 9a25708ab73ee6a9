"""Statistics of the rows of a run, with 95 % intervals."""
