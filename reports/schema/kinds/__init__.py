"""Columns and measures of each kind of trial; a module exports each `KindSchema` by the kind's name in ``SCHEMAS``."""
