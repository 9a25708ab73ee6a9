"""The schema of a scenario file: frozen pydantic models, unknown keys refused, units in key names."""
