"""Named campaigns, the runner, the run folder and the command line."""

from pathlib import Path

RUNS = Path("runs")
"""Folder of the run folders, unless another is given."""
