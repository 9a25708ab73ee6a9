"""Hostile input for every reader of files that a user may hand in, and what a reader may do with it."""
