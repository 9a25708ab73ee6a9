"""Scenarios that come with boresight, by name."""
