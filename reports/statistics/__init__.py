"""Statistics of rows, with intervals."""
