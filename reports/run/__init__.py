"""Stored runs: their tables, and the facts of each trial that all reports share."""
