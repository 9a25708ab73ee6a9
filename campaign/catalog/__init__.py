"""Campaigns that come with boresight, by name."""
