"""A stored run in the formats of others: TUM trajectories, COLMAP models, CSV, Parquet and LaTeX."""
