"""Shared parts of the kinds of trial: building and running methods, and scores."""
