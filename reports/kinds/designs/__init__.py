"""What a report tells of grids of scenarios."""
