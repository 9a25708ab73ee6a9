"""Engines of others on the same contract, to be compared with; each is an optional package."""
