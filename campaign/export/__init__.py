"""Export of stored runs as TUM trajectories, COLMAP models, CSV, Parquet and LaTeX."""
