"""Readers of what is asked for: scenarios, campaigns, data sets, overrides, options, published values."""

from __future__ import annotations
