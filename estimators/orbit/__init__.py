"""Orbit determination from crater sightings: the batch filter of Cheng et al. (2003) with radiometric data."""
