"""Orbit determination from crater sightings or positions of the body: the batch filter of Cheng et al. (2003)."""
