"""Scenario files and the simulated world: schema, geometry, bodies, lighting, motion and error distributions."""
