"""Smoothing with the orbit's dynamics: gravity parameter and solar radiation pressure are estimated on the way."""
