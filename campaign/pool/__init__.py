"""Worker processes, and time limits and output capture for methods."""
