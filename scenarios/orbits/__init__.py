"""Simulation of orbit determination about a small body: true orbit, crater sightings, radiometry and a priori data."""
