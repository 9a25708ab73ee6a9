"""Measures of a report: names, units and labels, and a line of the tidy table."""
