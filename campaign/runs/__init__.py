"""From the name of a campaign to a finished run."""
