"""Named campaigns, the runner, the run folder and the command line."""
