"""What the numbers of a report are: their names, units and labels, and one line of the tidy table."""
